"""MPPI against the published algorithm, as plain loops, on the same random numbers."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from clothkit.planning.optimisers.distribution import random_draws
from clothkit.planning.optimisers.mppi import MPPIConfig, path_integral, weights
from tests.planning.optimisers import bowl
from tests.planning.optimisers.by_hand import hands, loss_of, moments, nominal_plan, pair_at, plan_of

SIZE = MPPIConfig(plans=40, iterations=6, temperature=0.3, std=0.2, explore=0.3, chunk=20, finalists=4)


def published(settings: MPPIConfig, length: int, key: Array) -> np.ndarray:
    """The losses of all populations."""
    space = bowl.space(length)
    key_first, key_rest = jax.random.split(key)
    plans = list(np.asarray(space.sample(settings.plans, key=key_first).plan, np.float64))
    nominal = moments(plans, [1.0] * len(plans))
    record = []
    for key in jax.random.split(key_rest, settings.iterations):
        losses = np.array([loss_of(plan, bowl.TARGET[:length]) for plan in plans])
        record.append(losses)
        weight = np.exp(-(losses - losses.min()) / settings.temperature)
        nominal = moments(plans, list(weight / weight.sum()), nominal)
        key_random, key_draws, key_explore = jax.random.split(key, 3)
        random = np.asarray(space.sample(settings.plans, key=key_random).plan)
        draws = bowl.as_arrays(random_draws(settings.plans, length, key=key_draws))
        explores = np.asarray(jax.random.bernoulli(key_explore, settings.explore, (settings.plans,)))
        plans = [nominal_plan(nominal)]
        for row in range(1, settings.plans):
            pair = pair_at(nominal.pairs, draws.pair[row])
            single = [pair[0] == pair[1], *(draws.hands[row, 1:] < nominal.single[1:])]
            if explores[row]:
                one, other = sorted(bowl.index_of(grasp) for grasp in random[row, 0, :4].reshape(2, 2))
                pair = one, other
                single = [hands(manipulation) == 1 for manipulation in random[row]]
            std = np.full((length, 2, 6), settings.std)
            plans.append(plan_of(nominal, pair, single, draws.noise[row], std))
    return np.array(record)


def test_is_the_published_algorithm() -> None:
    search = jax.jit(lambda key: path_integral(bowl.objective(3), bowl.space(3), SIZE, key=key).losses)
    losses = search(jax.random.key(1))
    np.testing.assert_allclose(losses, published(SIZE, 3, jax.random.key(1)), rtol=1e-4, atol=1e-5)


def test_weights() -> None:
    infinite = jnp.full(2, jnp.inf)
    np.testing.assert_array_equal(weights(infinite, 0.5), [0, 0])
    got = weights(jnp.array([3, jnp.inf, 2, 2.5]), 0.5)
    np.testing.assert_allclose(got, [np.exp(-2), 0, 1, np.exp(-1)], rtol=1e-6)
