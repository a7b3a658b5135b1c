"""Greedy search against choosing one manipulation after the other by plain loops."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from clothkit.planning.optimisers.greedy import GreedyConfig, greedy
from clothkit.planning.optimisers.registry import optimise
from clothkit.planning.optimisers.space import Evaluation, Plans
from tests.planning.optimisers import bowl
from tests.planning.optimisers.by_hand import loss_of

SIZE = GreedyConfig(plans=30, chunk=10, finalists=3)


def test_the_best_next_manipulation() -> None:
    space, key = bowl.space(3), jax.random.key(0)
    got = bowl.as_arrays(jax.jit(lambda key: greedy(bowl.objective(3), space, SIZE, key=key))(key))
    chosen = np.zeros((0, 6))
    for step, each in enumerate(jax.random.split(key, 3)):
        drawn = np.asarray(space.sample(30, key=each).plan)
        tried = [np.concatenate([chosen, plan[step : step + 1]]) for plan in drawn]
        losses = np.array([loss_of(plan, bowl.TARGET[: step + 1]) for plan in tried])
        np.testing.assert_allclose(got.losses[step], losses, rtol=1e-5)
        chosen = tried[losses.argmin()]
    np.testing.assert_allclose(got.best.plans.plan[0], chosen, rtol=1e-6)
    assert (np.diff(got.best.loss) >= 0).all()


def test_never_moves_away_from_the_goal_first() -> None:
    """The goal is (0.4, 0) away, yet two manipulations reach it by (1, 1) and (-0.6, -1) alone."""

    def evaluate(plans: Plans, *, steps: Array | None = None, exact: bool = False) -> Evaluation:
        # Where the cloth ends up; manipulations shorter than 0.9 do nothing.
        moves = plans.plan[..., 4:]
        counted = jnp.linalg.norm(moves, axis=-1) > 0.9
        if steps is not None:
            counted &= jnp.arange(2) < steps
        reached = jnp.sum(jnp.where(counted[..., None], moves, 0), axis=1)
        return Evaluation(jnp.sum((reached - jnp.array([0.4, 0.0])) ** 2, axis=-1), plans.labels)

    settings = GreedyConfig(plans=500, chunk=500)
    found = jax.jit(lambda key: optimise(evaluate, bowl.space(2), settings, key=key))(jax.random.key(0))
    # The first manipulation is none, as all others lead farther away; a single one can't do it.
    assert np.linalg.norm(found.plan[0, 4:]) < 0.9
    assert 0.15 < found.loss < 0.17
