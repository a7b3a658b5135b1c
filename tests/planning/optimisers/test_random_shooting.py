"""Random shooting against evaluating every plan that was drawn."""

import jax
import numpy as np
import pydantic
import pytest
from jaxtyping import Array

from clothkit.planning.optimisers.random_shooting import RandomShootingConfig, shoot
from clothkit.planning.optimisers.space import Outcome
from tests.planning.optimisers import bowl
from tests.planning.optimisers.by_hand import loss_of

SIZE = RandomShootingConfig(plans=60, chunk=20, finalists=7)


def test_the_best_of_all_plans() -> None:
    space = bowl.space(2)

    def search(key: Array) -> Outcome:
        return shoot(bowl.objective(2), space, SIZE, key=key)

    got = bowl.as_arrays(jax.jit(search)(jax.random.key(0)))
    key_first, key_rest = jax.random.split(jax.random.key(0))
    # Each iteration draws the plans of the next one.
    keys = [key_first, *jax.random.split(key_rest, 3)[:2]]
    plans = np.concatenate([space.sample(20, key=key).plan for key in keys])
    losses = np.array([loss_of(plan, bowl.TARGET[:2]) for plan in plans])
    np.testing.assert_allclose(got.losses.ravel(), losses, rtol=1e-5)
    order = losses.argsort()[:7]
    np.testing.assert_array_equal(got.best.plans.plan, plans[order])
    np.testing.assert_allclose(got.best.loss, losses[order], rtol=1e-5)
    np.testing.assert_array_equal(got.best.labels["common"], got.best.plans.labels["common"] + 100)


def test_sizes_that_do_not_fit() -> None:
    assert RandomShootingConfig(plans=7, finalists=7).evaluations(3) == 7
    for sizes in ({"plans": 100, "chunk": 30, "finalists": 5}, {"plans": 100, "chunk": 10, "finalists": 11}):
        with pytest.raises(pydantic.ValidationError):
            RandomShootingConfig(**sizes)
