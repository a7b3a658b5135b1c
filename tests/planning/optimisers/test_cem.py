"""The cross-entropy method against the published one, as plain loops, on the same random numbers."""

import jax
import numpy as np
import pydantic
import pytest
from jaxtyping import Array

from clothkit.planning.optimisers.cem import CEMConfig, cross_entropy
from clothkit.planning.optimisers.distribution import random_draws
from clothkit.planning.optimisers.space import Plans
from tests.planning.optimisers import bowl
from tests.planning.optimisers.by_hand import Distribution, loss_of, moments, nominal_plan, pair_at, plan_of

SIZE = CEMConfig(plans=60, iterations=6, elites=12, smoothing=0.2, chunk=20, finalists=4)


def published(settings: CEMConfig, length: int, key: Array, forbidden: float = np.inf) -> np.ndarray:
    """The losses of all populations. Plans whose first dx is greater than `forbidden` are never elites."""
    key_first, key_rest = jax.random.split(key)
    plans = list(np.asarray(bowl.space(length).sample(settings.plans, key=key_first).plan, np.float64))
    old = moments(plans, [1.0] * len(plans))
    record = []
    for key in jax.random.split(key_rest, settings.iterations):
        losses = [np.inf if plan[0, 4] > forbidden else loss_of(plan, bowl.TARGET[:length]) for plan in plans]
        record.append(losses)
        ranked = sorted(range(len(plans)), key=losses.__getitem__)
        elites = [plans[i] for i in ranked[: settings.elites] if losses[i] < np.inf]
        new = moments(elites, [1.0] * len(elites), old)
        keep = settings.smoothing
        old = Distribution(*(keep * vars(old)[name] + (1 - keep) * vars(new)[name] for name in vars(new)))
        draws = bowl.as_arrays(random_draws(settings.plans, length, key=jax.random.split(key)[1]))
        plans = [nominal_plan(old)]
        for chance, chances, noise in zip(draws.pair[1:], draws.hands[1:], draws.noise[1:], strict=True):
            pair = pair_at(old.pairs, chance)
            single = [pair[0] == pair[1], *(chances[1:] < old.single[1:])]
            plans.append(plan_of(old, pair, single, noise, np.sqrt(old.variance)))
    return np.array(record)


@pytest.mark.parametrize("forbidden", [np.inf, 0.2])
def test_is_the_published_method(forbidden: float) -> None:
    def valid(plans: Plans) -> Array:
        return plans.plan[:, 0, 4] <= forbidden

    def search(key: Array) -> Array:
        return cross_entropy(bowl.objective(3), bowl.space(3, valid=valid), SIZE, key=key).losses

    losses = jax.jit(search)(jax.random.key(0))
    np.testing.assert_allclose(losses, published(SIZE, 3, jax.random.key(0), forbidden), rtol=1e-4, atol=1e-5)


def test_sizes_that_do_not_fit() -> None:
    for sizes in ({"plans": 100, "chunk": 30}, {"plans": 10, "elites": 20, "finalists": 5}, {"plans": 10}):
        with pytest.raises(pydantic.ValidationError):
            CEMConfig(**sizes)
