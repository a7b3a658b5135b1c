"""What holds for every optimiser, on a bowl with a known bottom and on a rippled one."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

from clothkit.planning.optimisers.cem import CEMConfig
from clothkit.planning.optimisers.gradient import GradientConfig
from clothkit.planning.optimisers.greedy import GreedyConfig
from clothkit.planning.optimisers.hybrid import HybridConfig
from clothkit.planning.optimisers.mppi import MPPIConfig
from clothkit.planning.optimisers.random_shooting import RandomShootingConfig
from clothkit.planning.optimisers.registry import OPTIMISERS, evaluations, optimise
from clothkit.planning.optimisers.space import Evaluate, Evaluation, Initial, Plans, Result, Settings, Space
from tests.planning.optimisers import bowl

SETTINGS: dict[str, Any] = {
    "gradient": GradientConfig(strains=32, screen=2, near=0.25, halvings=1, base_iterations=10),
    "random_shooting": RandomShootingConfig(plans=2000, chunk=500),
    "cem": CEMConfig(plans=400, elites=60, chunk=100, finalists=16),
    "mppi": MPPIConfig(plans=400, chunk=400, finalists=16),
    "greedy": GreedyConfig(plans=1000, chunk=500, finalists=16),
    "hybrid": HybridConfig(
        phases=(
            CEMConfig(plans=200, elites=40, iterations=4, chunk=200, finalists=48),
            GradientConfig(strains=32, base_iterations=10, iterations_per_step=10, near=1.0, halvings=1),
        )
    ),
}
# Squared distances to the bottom that the sizes above leave, for two manipulations.
REACHED = {"gradient": 1e-2, "random_shooting": 1.2, "cem": 1e-2, "mppi": 0.05, "greedy": 0.3, "hybrid": 1e-3}
EACH = pytest.mark.parametrize("name", SETTINGS)


def run(evaluate: Evaluate, space: Space, settings: Settings, seed: int = 0, initial: Initial | None = None) -> Result:
    """One search, compiled."""
    search = jax.jit(lambda key: optimise(evaluate, space, settings, initial=initial, key=key))
    return bowl.as_arrays(search(jax.random.key(seed)))


def test_all_are_registered() -> None:
    assert set(SETTINGS) == set(OPTIMISERS)


@EACH
def test_finds_a_known_plan_with_as_many_evaluations_as_settings_say(name: str) -> None:
    counted: list[int] = []
    found = run(bowl.objective(2, count=counted.append, offset=0.125), bowl.space(2), SETTINGS[name])
    jax.effects_barrier()
    assert sum(counted) == evaluations(SETTINGS[name], 2)
    grasps, displacements = (float(part) for part in bowl.distance(jnp.asarray(found.plan), bowl.TARGET[:2]))
    assert bowl.is_plan(found.plan)
    assert grasps + displacements < REACHED[name]
    # The loss is the exact one, its terms and labels are those of the plan.
    np.testing.assert_allclose(found.loss, grasps + displacements + 0.125, rtol=1e-5)
    np.testing.assert_allclose(found.terms["grasps"], grasps, atol=1e-6)
    # The objective settles labels twice: in the search, then once more when the plan is chosen.
    assert 200 <= found.labels["common"] < 208
    np.testing.assert_allclose(found.losses.min() + 0.125, found.loss, rtol=1e-5)
    assert not np.isnan(found.losses).any()
    assert found.losses.shape == found.restarts.shape


@EACH
def test_the_record_has_a_loss_for_every_evaluation(name: str) -> None:
    """But for those that screen a gradient search's first starts."""
    settings = SETTINGS[name]
    found = run(bowl.objective(2), bowl.space(2), settings)
    screened = settings.strains * settings.screen if name == "gradient" else 0
    assert np.isfinite(found.losses).sum() == settings.evaluations(2) - screened


@EACH
def test_plans_that_are_not_valid_never_win(name: str) -> None:
    """The best plans move to the right; those that do are forbidden."""

    def valid(plans: Plans) -> Array:
        return plans.plan[:, 0, 4] < 0.2

    found = run(bowl.objective(1), bowl.space(1, valid=valid), SETTINGS[name])
    assert found.plan[0, 4] < 0.2
    # It comes as near as it may.
    assert found.loss < 0.16 + REACHED[name]
    assert np.isinf(found.losses).any()
    assert found.losses.min() > 0.15


@EACH
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_losses_that_are_not_finite_never_win(name: str, bad: float) -> None:
    """Neither in the search nor when the plan is chosen."""
    plain = bowl.objective(1)

    def evaluate(plans: Plans, *, steps: Array | None = None, exact: bool = False) -> Evaluation:
        evaluation = plain(plans, steps=steps, exact=exact)
        return evaluation._replace(loss=jnp.where(plans.plan[:, 0, 4] > 0.2, bad, evaluation.loss))

    found = run(evaluate, bowl.space(1), SETTINGS[name])
    assert found.plan[0, 4] <= 0.2
    assert found.loss < 0.16 + REACHED[name]
    assert not np.isnan(found.losses).any()
    assert found.losses.min() > 0.15


@EACH
def test_with_no_valid_plan_all_losses_are_infinite(name: str) -> None:
    found = run(bowl.objective(1), bowl.space(1, valid=lambda plans: jnp.zeros(len(plans.plan), bool)), SETTINGS[name])
    assert np.isinf(found.losses).all()
    assert np.isfinite(found.plan).all()


@EACH
def test_initial_plans_are_tried(name: str) -> None:
    """The best plan is given, beside one that is marked as none and would be better still."""
    length = 2
    plan = np.stack([bowl.TARGET[:length] + np.float32([0, 0, 0, 0, shift, 0]) for shift in (0.0, 0.003)])
    initial = Initial(Plans(jnp.asarray(plan), {"common": jnp.array([5, 6])}), np.array([False, True]))
    found = run(bowl.objective(length), bowl.space(length), SETTINGS[name], initial=initial)
    assert found.loss <= 2 * 0.003**2 + 1e-8
    nothing = initial._replace(given=np.array([False, False]))
    same = run(bowl.objective(length), bowl.space(length), SETTINGS[name], initial=nothing)
    jax.tree.map(np.testing.assert_array_equal, same, run(bowl.objective(length), bowl.space(length), SETTINGS[name]))


@EACH
def test_searches_of_a_batch_are_those_one_by_one(name: str) -> None:
    """The same key gives the same result, beside any neighbour; different targets give different plans."""

    def search(target: Array, key: Array) -> Result:
        def evaluate(plans: Plans, *, steps: Array | None = None, exact: bool = False) -> Evaluation:
            return Evaluation(sum(bowl.distance(plans.plan, target, steps)), plans.labels)

        return optimise(evaluate, bowl.space(1), SETTINGS[name], key=key)

    targets = jnp.asarray(bowl.TARGET[:2, None])
    keys = jnp.stack([jax.random.key(3), jax.random.key(4)])
    together = bowl.as_arrays(jax.jit(jax.vmap(search))(targets, keys))
    one_by_one = jax.jit(search)
    for row in range(2):
        alone = bowl.as_arrays(one_by_one(targets[row], keys[row]))
        jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-5, atol=1e-6), take(together, row), alone)
        again = bowl.as_arrays(one_by_one(targets[row], keys[row]))
        jax.tree.map(np.testing.assert_array_equal, alone, again)
    assert np.abs(together.plan[0] - together.plan[1]).max() > 0.1


def take(tree: Any, row: int) -> Any:
    """A row of every array."""
    return jax.tree.map(lambda leaf: leaf[row], tree)


def test_where_descent_alone_fails() -> None:
    """Among ripples a strain that never restarts stays where it is; other optimisers, and restarts, reach the bottom."""
    evaluate, space = bowl.objective(1, extra=bowl.ripples), bowl.space(1)
    stuck = GradientConfig(strains=4, patience=1000)
    losses = [run(evaluate, space, stuck, seed).loss for seed in range(5)]
    assert np.median(losses) > 0.05
    for name in ("cem", "mppi", "hybrid"):
        assert run(evaluate, space, SETTINGS[name]).loss < 0.05
    assert run(evaluate, space, GradientConfig(strains=256, near=0.5)).loss < 0.05
