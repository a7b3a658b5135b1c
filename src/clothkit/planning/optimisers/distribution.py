"""Distributions of plans, which CEM and MPPI fit to good plans and draw new plans from.

A plan has discrete and continuous parts, and the mean of two plans is a plan only if their discrete parts are equal.
The discrete parts are the pair of candidates that the first manipulation grasps, which includes its number of hands,
and the number of hands of each later manipulation. They are categorical variables, whose probabilities are fitted by
(weighted) frequencies, as in the cross-entropy method (De Boer et al., 2005). The continuous parts of each manipulation
are normal, with moments of their own for one hand and for two. All parts are independent of each other, as is usual
there.

The two hands are interchangeable, so a mean over plans whose hands come in any order would lie between both hands.
Before moments are taken, each plan's hands are brought to the order in which they are nearer to those of the best plan.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from clothkit.manipulation.vector import is_single, swap_grasps
from clothkit.planning.optimisers.space import Space, clip_grasps

ONE, TWO = 0, 1
"""Indices along the axis `hands`."""


class PlanDistribution(NamedTuple):
    """Independent distributions of the parts of a plan; the first manipulation's grasp points are those of `pairs`."""

    pairs: Float[Array, "candidates candidates"]
    """Probabilities of the pairs of candidates; the lower of both indices comes first."""
    single: Float[Array, " n"]
    """Probability of one hand; that of the first manipulation is not used."""
    mean: Float[Array, "n hands 6"]
    variance: Float[Array, "n hands 6"]


class Choices(NamedTuple):
    """The discrete parts of plans."""

    pair: Int[Array, "plans 2"]
    """Indices of the candidates that the first manipulation grasps, in ascending order; equal for one hand."""
    single: Bool[Array, "plans n"]


class Draws(NamedTuple):
    """The random numbers from which plans are made."""

    pair: Float[Array, " plans"]
    """Uniform in 0..1."""
    hands: Float[Array, "plans n"]
    """Uniform in 0..1."""
    noise: Float[Array, "plans n 6"]
    """Standard normal, truncated at two standard deviations."""


def random_draws(count: int, length: int, *, key: PRNGKeyArray) -> Draws:
    """Random numbers for so many plans."""
    key_pair, key_hands, key_noise = jax.random.split(key, 3)
    return Draws(
        jax.random.uniform(key_pair, (count,)),
        jax.random.uniform(key_hands, (count, length)),
        jax.random.truncated_normal(key_noise, -2, 2, (count, length, 6)),
    )


def choices_of(space: Space, plan: Float[Array, "plans n 6"]) -> Choices:
    """The discrete parts of plans. First grasp points that are no candidates count as the nearest ones."""
    grasps = plan[:, 0, :4].reshape(-1, 2, 1, 2)
    squared = jnp.sum((grasps - jnp.asarray(space.candidates)) ** 2, axis=-1)
    present = jnp.arange(squared.shape[-1]) < space.present
    index = jnp.argmin(jnp.where(present, squared, jnp.inf), axis=-1)
    return Choices(jnp.sort(index, axis=-1), jnp.asarray(is_single(plan)))


def fit(
    space: Space,
    plan: Float[Array, "plans n 6"],
    weight: Float[Array, " plans"],
    before: PlanDistribution | None = None,
) -> PlanDistribution:
    """The distribution of greatest weighted likelihood; the plan of the largest weight decides on the order of hands.

    Parts for which there is nothing to fit them to (no weight at all, or no plan with so many hands) are taken from
    `before`. Without it, plans are taken with their hands in the order in which they are.
    """
    pair, single = choices_of(space, plan)
    if before is not None:
        plan = _aligned(plan, single, weight, before.mean[:, TWO])
    of_hands = jnp.stack([single, ~single], axis=-1) * weight[:, None, None]
    total = jnp.sum(of_hands, axis=0)[..., None]
    share = of_hands[..., None] / jnp.where(total > 0, total, 1)
    mean = jnp.sum(share * plan[:, :, None], axis=0)
    variance = jnp.sum(share * (plan[:, :, None] - mean) ** 2, axis=0)
    whole = jnp.sum(weight)
    weight = weight / jnp.where(whole > 0, whole, 1)
    # A matrix product, because the order in which a GPU adds scattered values is not fixed.
    one, other = jax.nn.one_hot(pair.T, len(space.candidates))
    pairs = jnp.matmul(one.T, other * weight[:, None], precision="highest")
    fitted = PlanDistribution(pairs, jnp.sum(single * weight[:, None], axis=0), mean, variance)
    if before is None:
        return fitted
    some = total > 0
    return PlanDistribution(
        jnp.where(whole > 0, fitted.pairs, before.pairs),
        jnp.where(whole > 0, fitted.single, before.single),
        jnp.where(some, mean, before.mean),
        jnp.where(some, variance, before.variance),
    )


def _aligned(
    plan: Float[Array, "plans n 6"],
    single: Bool[Array, "plans n"],
    weight: Float[Array, " plans"],
    mean: Float[Array, "n 6"],
) -> Float[Array, "plans n 6"]:
    """The plans with the hands of each manipulation in the order in which they are nearer to those of the best plan.

    The best is the two-handed one of the largest weight. Its own hands are in the order nearer to the mean.
    """
    best = jnp.argmax(jnp.where(single, -1, weight[:, None]), axis=0)
    reference = _nearer(jnp.take_along_axis(plan, best[None, :, None], axis=0)[0], mean)
    return _nearer(plan, reference)


def _nearer(plan: Float[Array, "*plans n 6"], reference: Float[Array, "n 6"]) -> Float[Array, "*plans n 6"]:
    swapped = swap_grasps(plan)
    distance, other = (jnp.sum((each - reference)[..., :4] ** 2, axis=-1, keepdims=True) for each in (plan, swapped))
    return jnp.where(other < distance, swapped, plan)


def mixed(before: PlanDistribution, after: PlanDistribution, share: float) -> PlanDistribution:
    """A share of the parameters of `before` and the rest of those of `after`."""
    return jax.tree.map(lambda a, b: share * a + (1 - share) * b, before, after)


def draw_choices(distribution: PlanDistribution, draws: Draws) -> Choices:
    """The discrete parts of plans that these random numbers make."""
    so_far = jnp.cumsum(distribution.pairs.ravel())
    # Rounding must not lead beyond the last pair that has a probability.
    reached = jnp.minimum(draws.pair * so_far[-1], jnp.nextafter(so_far[-1], 0.0))
    index = jnp.searchsorted(so_far, reached, side="right")
    pair = jnp.stack(jnp.divmod(index, len(distribution.pairs)), axis=-1)
    single = (draws.hands < distribution.single).at[:, 0].set(pair[:, 0] == pair[:, 1])
    return Choices(pair, single)


def complete(
    space: Space,
    distribution: PlanDistribution,
    choices: Choices,
    noise: Float[Array, "plans n 6"],
    std: Float[Array, "n hands 6"],
) -> Float[Array, "plans n 6"]:
    """Plans with these discrete parts, whose continuous parts are the means plus `std` times the noise."""
    hands = jnp.where(choices.single, ONE, TWO)
    step = jnp.arange(space.length)
    plan = distribution.mean[step, hands] + std[step, hands] * noise
    second = jnp.where(choices.single[..., None], plan[..., :2], plan[..., 2:4])
    plan = jnp.concatenate([plan[..., :2], second, plan[..., 4:]], axis=-1)
    first = jnp.asarray(space.candidates)[choices.pair].reshape(-1, 4)
    return clip_grasps(plan.at[:, 0, :4].set(first))


def mode(space: Space, distribution: PlanDistribution) -> Float[Array, "n 6"]:
    """The most probable plan."""
    pair = jnp.stack(jnp.divmod(jnp.argmax(distribution.pairs), len(distribution.pairs)))
    single = (distribution.single > 0.5).at[0].set(pair[0] == pair[1])
    none = jnp.zeros((1, space.length, 6))
    return complete(space, distribution, Choices(pair[None], single[None]), none, jnp.zeros_like(distribution.mean))[0]
