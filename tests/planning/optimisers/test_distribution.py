"""Distributions of plans: fitted to plans whose moments are known, whatever the order of the hands."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from clothkit.manipulation.vector import swap_grasps
from clothkit.planning.optimisers.distribution import (
    ONE,
    TWO,
    Choices,
    Draws,
    PlanDistribution,
    choices_of,
    complete,
    draw_choices,
    fit,
    mode,
    random_draws,
)
from tests.planning.optimisers import bowl

SPACE = bowl.space(2)
BEFORE = PlanDistribution(
    jnp.zeros((7, 7)).at[0, 0].set(1.0), jnp.array([0.5, 0.5]), jnp.full((2, 2, 6), 9.0), jnp.full((2, 2, 6), 4.0)
)
PLANS = jnp.array(
    [
        # Candidates 2 and 1, then two hands.
        [[1, -1, -1, 1, 0.5, 0.1], [0.1, 0.2, 0.7, 0.8, 0.3, 0.4]],
        # Candidates 1 and 2: the same pair. The second manipulation's hands are nearly those above, in the other order.
        [[-1, 1, 1, -1, 0.7, 0.3], [0.7, 0.6, 0.3, 0.2, 0.5, 0.8]],
        # One hand on candidate 4, then one hand.
        [[0.2, 0.1, 0.2, 0.1, -1, 0], [0.5, 0.5, 0.5, 0.5, 1, -1]],
    ],
    jnp.float32,
)


def test_moments_by_hand() -> None:
    got = fit(SPACE, PLANS, jnp.array([2.0, 1.0, 1.0]), BEFORE)
    expected = np.zeros((7, 7))
    expected[1, 2], expected[4, 4] = 0.75, 0.25
    np.testing.assert_allclose(got.pairs, expected, atol=1e-6)
    np.testing.assert_allclose(got.single, [0.25, 0.25], rtol=1e-6)
    # (2 * first + second) / 3, with the second's hands exchanged.
    np.testing.assert_allclose(got.mean[1, TWO], [1 / 6, 0.2, 0.7, 2.2 / 3, 1.1 / 3, 1.6 / 3], rtol=1e-5)
    np.testing.assert_allclose(got.variance[1, TWO, 4], (2 * (0.2 / 3) ** 2 + (0.4 / 3) ** 2) / 3, rtol=1e-4)
    np.testing.assert_allclose(got.mean[1, ONE], PLANS[2, 1], rtol=1e-6)
    np.testing.assert_allclose(got.variance[1, ONE], 0, atol=1e-6)
    np.testing.assert_allclose(got.mean[0, TWO, 4:], [1.7 / 3, 0.5 / 3], rtol=1e-5)


def test_what_no_plan_tells_is_kept() -> None:
    nothing = fit(SPACE, PLANS, jnp.zeros(3), BEFORE)
    jax.tree.map(np.testing.assert_array_equal, nothing, BEFORE)
    two_hands = fit(SPACE, PLANS, jnp.array([1.0, 1.0, 0.0]), BEFORE)
    np.testing.assert_array_equal(two_hands.mean[:, ONE], BEFORE.mean[:, ONE])
    np.testing.assert_array_equal(two_hands.variance[:, ONE], BEFORE.variance[:, ONE])
    np.testing.assert_array_equal(two_hands.single, [0, 0])


@given(st.lists(st.booleans(), min_size=20, max_size=20), st.integers(0, 5))
def test_the_order_of_hands_does_not_matter(swaps: list[bool], seed: int) -> None:
    """However the hands of plans are ordered, the same plans are drawn."""
    plan = SPACE.sample(20, key=jax.random.key(seed)).plan
    weight = jnp.linspace(1.0, 0.1, 20)
    before = fit(SPACE, plan, weight)
    swapped = jnp.where(jnp.array(swaps)[:, None, None], swap_grasps(plan), plan)
    a, b = fit(SPACE, plan, weight, before), fit(SPACE, swapped, weight, before)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-5), (a.pairs, a.single), (b.pairs, b.single))
    np.testing.assert_allclose(a.mean[1], b.mean[1], atol=1e-5)
    np.testing.assert_allclose(a.variance[1], b.variance[1], atol=1e-5)


def test_plans_that_are_drawn_have_the_distribution() -> None:
    count = 20000
    distribution = fit(SPACE, PLANS, jnp.ones(3))._replace(variance=jnp.full((2, 2, 6), 0.01))
    draws = random_draws(count, 2, key=jax.random.key(0))
    choices = draw_choices(distribution, draws)
    plan = np.asarray(complete(SPACE, distribution, choices, draws.noise, jnp.sqrt(distribution.variance)))
    again = choices_of(SPACE, jnp.asarray(plan))
    np.testing.assert_array_equal(again.pair, choices.pair)
    np.testing.assert_array_equal(again.single, choices.single)
    pairs, counts = np.unique(np.asarray(choices.pair), axis=0, return_counts=True)
    assert pairs.tolist() == [[1, 2], [4, 4]]
    np.testing.assert_allclose(counts / count, [2 / 3, 1 / 3], atol=0.02)
    single = np.asarray(choices.single)
    np.testing.assert_array_equal(single[:, 0], choices.pair[:, 0] == choices.pair[:, 1])
    np.testing.assert_allclose(single.mean(0), 1 / 3, atol=0.02)
    one = plan[single[:, 1], 1]
    np.testing.assert_allclose(one.mean(0), PLANS[2, 1], atol=0.01)
    # A normal distribution that is truncated at two standard deviations has 0.880 of the standard deviation.
    np.testing.assert_allclose(one[:, 4].std(), 0.088, atol=0.003)
    assert np.abs(one[:, 4] - 1).max() <= 0.2 + 1e-6
    assert bowl.is_plan(np.asarray(mode(SPACE, distribution)))


def test_the_mode() -> None:
    got = mode(SPACE, fit(SPACE, PLANS, jnp.array([1.0, 1.0, 3.0]), BEFORE))
    np.testing.assert_allclose(got, PLANS[2], rtol=1e-6)
    got = mode(SPACE, fit(SPACE, PLANS, jnp.array([1.0, 0.5, 1.0]), BEFORE))
    # The lower index comes first: candidate 1, then 2.
    np.testing.assert_allclose(got[0, :4], [-1, 1, 1, -1])
    np.testing.assert_allclose(got[1, :2], [(0.1 + 0.5 * 0.3) / 1.5, 0.2], rtol=1e-5)


def test_extreme_random_numbers() -> None:
    """The last pair that has a probability is the last that is drawn; grasp points stay on the cloth."""
    pairs = jnp.zeros((7, 7)).at[0, 1].set(0.7).at[2, 3].set(0.3)
    distribution = BEFORE._replace(pairs=pairs)
    last = float(np.nextafter(np.float32(1), np.float32(0)))
    draws = Draws(jnp.array([0.0, 0.69, 0.71, last]), jnp.zeros((4, 2)), jnp.zeros((4, 2, 6)))
    choices = draw_choices(distribution, draws)
    assert choices.pair.tolist() == [[0, 1], [0, 1], [2, 3], [2, 3]]
    plan = complete(SPACE, distribution, Choices(choices.pair, choices.single), draws.noise, distribution.variance)
    assert float(jnp.abs(plan[..., :4]).max()) == 1
