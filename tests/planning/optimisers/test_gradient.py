"""The gradient search against section 5.1, as loops over strains and components, on the same random plans."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pydantic
import pytest
from jaxtyping import Array

from clothkit.planning.irprop import IRpropConfig
from clothkit.planning.optimisers.gradient import GradientConfig, _draws, _moved, _some_near, _started, descend
from clothkit.planning.optimisers.space import Best, Evaluation, Initial, Outcome, Plans
from tests.planning.optimisers import bowl

SIZE = GradientConfig(strains=8, base_iterations=40, iterations_per_step=0, patience=3)
LENGTH = 2
SLOPES = np.linspace(0.5, 3, 12).reshape(2, 6)
TARGET = bowl.TARGET[:LENGTH]


def smooth(plans: Plans, *, steps: Array | None = None, exact: bool = False) -> Evaluation:
    """A bowl with a slope of its own along every component, whose gradient is as easy to write down."""
    return Evaluation(jnp.sum(SLOPES * (plans.plan - TARGET) ** 2, axis=(-2, -1)), plans.labels)


def step_by_hand(
    plan: np.ndarray, single: np.ndarray, gradient: np.ndarray, before: np.ndarray, rate: np.ndarray
) -> None:
    """One iRprop- step in place (Igel and Hüsken, 2000), hand by hand."""
    gradient = gradient.copy()
    gradient[0, :4] = 0
    for step in range(LENGTH):
        if single[step]:
            gradient[step, :2] = gradient[step, 2:4] = gradient[step, :2] + gradient[step, 2:4]
    for at in np.ndindex(plan.shape):
        agreement = np.sign(gradient[at]) * np.sign(before[at])
        if agreement > 0:
            rate[at] = min(rate[at] * 1.2, 0.05)
        elif agreement < 0:
            rate[at] = max(rate[at] * 0.5, 1e-3)
            gradient[at] = 0
        plan[at] -= np.sign(gradient[at]) * rate[at]
        before[at] = gradient[at]
    plan[:, :4] = plan[:, :4].clip(-1, 1)


def published(settings: GradientConfig, key: Array) -> tuple[np.ndarray, np.ndarray]:
    """The record of losses, and the best loss of each strain."""
    space, count = bowl.space(LENGTH), settings.strains
    every = np.asarray(_draws(space, settings.iterations(LENGTH) * count, 0.0, key=jax.random.split(key)[1]).plans.plan)
    plans, singles = [np.zeros((LENGTH, 6))] * count, [np.zeros(LENGTH, bool)] * count
    before, rates = [np.zeros((LENGTH, 6))] * count, [np.zeros((LENGTH, 6))] * count
    lowest, best, stale, restart = [np.inf] * count, [np.inf] * count, [0] * count, [True] * count
    losses, restarts = [], 0
    for drawn in every.reshape(-1, count, LENGTH, 6).astype(np.float64):
        record = []
        for s in range(count):
            if restart[s]:
                plans[s] = drawn[s].copy()
                singles[s] = (drawn[s, :, :2] == drawn[s, :, 2:4]).all(-1)
                before[s], rates[s], lowest[s], stale[s] = np.zeros((LENGTH, 6)), np.full((LENGTH, 6), 0.05), np.inf, 0
            loss = float((SLOPES * (plans[s] - TARGET) ** 2).sum())
            record.append(loss)
            best[s] = min(best[s], loss)
            stale[s] = 0 if loss < lowest[s] else stale[s] + 1
            lowest[s] = min(lowest[s], loss)
            restart[s] = stale[s] >= settings.patience
            restarts += restart[s]
            step_by_hand(plans[s], singles[s], 2 * SLOPES * (plans[s] - TARGET), before[s], rates[s])
        losses.append(record)
    assert restarts
    return np.array(losses), np.array(best)


def run(settings: GradientConfig, seed: int = 0, initial: Initial | None = None) -> Outcome:
    search = jax.jit(lambda key: descend(smooth, bowl.space(LENGTH), settings, initial=initial, key=key))
    return bowl.as_arrays(search(jax.random.key(seed)))


def test_is_the_search_of_the_paper() -> None:
    losses, best = published(SIZE, jax.random.key(1))
    got = run(SIZE, seed=1)
    np.testing.assert_allclose(got.losses, losses, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(got.best.loss, best, rtol=1e-4, atol=1e-5)


def test_restarts_near_the_best_plan() -> None:
    """The best of all strains, moved a little; first grasp points its own or those that were drawn."""
    count = 64
    space = bowl.space(LENGTH)
    best_plan = np.array([[-1, -1, -1, -1, 0.7, 0.4], [0.95, 0.2, -0.3, 0.1, 0.5, -0.6]], np.float32)
    # Only one strain's plan is any good, and it is not the first.
    good = np.arange(count) == 5
    plans = Plans(jnp.where(good[:, None, None], best_plan, 9.0), {"common": jnp.arange(count) % 8})
    best = Best(plans, plans.labels, jnp.where(good, 0.1, 1.0))
    draws = _draws(space, count, 0.75, key=jax.random.key(0))
    drawn, got = draws.plans, _some_near(best, draws)
    np.testing.assert_array_equal(got.labels["common"], drawn.labels["common"])
    plan = np.asarray(got.plan)
    near = np.abs(plan - np.asarray(drawn.plan)).max((1, 2)) > 0
    assert 0.5 < near.mean() < 0.95
    moved = plan[near] - best_plan
    assert 0.1 < moved[..., 4:].std() < 0.2
    assert 0.05 < np.abs(moved[:, 1, :4]).mean() < 0.2
    assert np.abs(plan[..., :4]).max() <= 1
    own = np.abs(moved[:, 0, :4]).max(1) == 0
    assert 0.3 < own.mean() < 0.7
    np.testing.assert_array_equal(plan[near][~own, 0, :4], np.asarray(drawn.plan)[near][~own, 0, :4])
    # One hand stays one hand.
    single = best_plan.copy()
    single[1, 2:4] = single[1, :2]
    plans = plans._replace(plan=jnp.broadcast_to(jnp.asarray(single), plan.shape))
    plan = np.asarray(_some_near(best._replace(plans=plans), draws._replace(near=jnp.ones(count, bool))).plan)
    np.testing.assert_array_equal(plan[:, 1, :2], plan[:, 1, 2:4])
    # Nothing is near a best plan that there isn't.
    none = best._replace(loss=jnp.full(count, jnp.inf))
    same = _some_near(none, draws)
    jax.tree.map(np.testing.assert_array_equal, same, drawn)


def test_one_strain_moves_as_one_hand() -> None:
    plan = jnp.array([[[0.1, 0.2, 0.3, 0.4, 0, 0], [0.99, 0.5, 0.99, 0.5, 0, 0]]] * 2)
    strains = _started(Plans(plan, ()), IRpropConfig())._replace(single=jnp.array([[False, True], [True, False]]))
    gradient = jnp.broadcast_to(jnp.array([-3.0, 2.0, 1.0, -3.0, 1.0, -1.0]), plan.shape)
    moved = _moved(strains, gradient, IRpropConfig()).plans.plan
    np.testing.assert_array_equal(moved[:, 0, :4], plan[:, 0, :4])
    # Both hands' slopes together: -2 along u, -1 along v; u ends at the cloth's edge.
    np.testing.assert_allclose(moved[0, 1], [1, 0.55, 1, 0.55, -0.05, 0.05], rtol=1e-6)
    np.testing.assert_allclose(moved[1, 1], [1, 0.45, 0.94, 0.55, -0.05, 0.05], rtol=1e-6)


def test_screened_strains_start_where_the_loss_is_least() -> None:
    """First losses are the least of so many consecutive draws each; initial plans are not replaced."""
    settings = GradientConfig(strains=8, base_iterations=1, iterations_per_step=0, screen=5)
    initial = Initial(Plans(jnp.full((2, LENGTH, 6), 0.5), {"common": jnp.array([1, 2])}), np.array([False, True]))
    got = run(settings, initial=initial)
    drawn = bowl.space(LENGTH).sample(8, draws=5, key=jax.random.split(jax.random.key(0))[0])
    losses = np.asarray(smooth(drawn).loss)
    expected = losses.reshape(8, 5).min(1)
    expected[1] = (SLOPES * (0.5 - TARGET) ** 2).sum()
    np.testing.assert_allclose(got.losses[0], expected, rtol=1e-5)


def test_halving_keeps_the_better_strains() -> None:
    settings = GradientConfig(strains=16, screen=2, base_iterations=8, iterations_per_step=4, halvings=2, patience=100)
    assert settings.rounds(LENGTH) == [(16, 4), (8, 8), (4, 16)]
    assert settings.evaluations(LENGTH) == 16 * 2 + 3 * 4 * 8 + 16 * 4 + 8 * 8 + 4 * 16
    assert settings.shape(LENGTH) == (3 * 16, 4)
    got = run(settings)
    whole = run(GradientConfig(strains=16, screen=2, base_iterations=28, iterations_per_step=0, patience=100)).losses
    # Groups of four strains take turns; those that are left go on as if nothing had happened, in order of their losses.
    np.testing.assert_array_equal(got.losses[:16].reshape(4, 16), whole[:4])
    kept = whole[:4].min(0).argsort()[:8]
    np.testing.assert_allclose(got.losses[16:32].reshape(8, 8), whole[4:12][:, kept], rtol=1e-5)
    kept = kept[whole[:12][:, kept].min(0).argsort()[:4]]
    np.testing.assert_allclose(got.losses[32:], whole[12:][:, kept], rtol=1e-5)
    np.testing.assert_allclose(got.best.loss, np.sort(whole[:, kept].min(0)), rtol=1e-5)


def test_after_each_round_the_best_strains_are_in_the_labels_that_suit_them_best() -> None:
    """Plans are best in the label 5."""

    def labelled(plans: Plans, **asked: Any) -> Evaluation:
        return Evaluation(smooth(plans).loss + 0.3 * jnp.abs(plans.labels["common"] - 5), plans.labels)

    settings = GradientConfig(strains=8, screen=2, base_iterations=8, iterations_per_step=0, halvings=1, patience=100)
    space = bowl.space(LENGTH)
    got = jax.jit(lambda key: descend(labelled, space, settings, key=key))(jax.random.key(0))
    fixed = space._replace(variants=lambda plans: plans)
    same = jax.jit(lambda key: descend(labelled, fixed, settings, key=key))(jax.random.key(0))
    np.testing.assert_array_equal(got.losses[:8], same.losses[:8])
    assert (got.best.plans.labels["common"] == 5).all()
    left = np.asarray(same.best.plans.labels["common"])
    assert (left != 5).any()
    # The same strains are left; they differ by what their labels cost.
    apart = np.asarray(same.losses[8:]) - np.asarray(got.losses[8:])
    kept = np.abs(apart - apart[0]).max(0) < 1e-4
    assert kept.any()
    assert np.isclose(apart[0][kept][:, None], 0.3 * np.arange(8), atol=1e-4).any(1).all()


def test_strains_that_cannot_be_halved() -> None:
    for name in ("strains", "base_iterations", "iterations_per_step"):
        whole = {"strains": 16, "base_iterations": 8, "iterations_per_step": 8}
        with pytest.raises(pydantic.ValidationError, match=f"{name} must be a multiple of 8"):
            GradientConfig(**{**whole, name: 12}, halvings=3)
