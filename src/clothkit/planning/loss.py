"""The terms of the planning loss: accuracy and epistemic uncertainty, eqs. (13) to (15).

These functions take goals that are whitened already, because goals do not change during a search. They whiten the
predictions themselves.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from clothkit.cloth.mesh import ProbabilisticMesh, nll, whiten_probabilistic

LARGEST_EXPONENT = 20.0
"""Above this x, e^x in eq. (15) is replaced by its tangent, which is finite in float32 and has a positive slope."""

Scalar = float | int | np.float32 | Float[Array, ""]


class Weights(NamedTuple):
    """The weights of the planning loss: alpha of eq. (13), beta and gamma of eq. (15)."""

    alpha: Scalar
    beta: Scalar
    gamma: Scalar


class Range(NamedTuple):
    """The reference values low and high of eq. (14), for one net and one plan length."""

    low: Scalar
    high: Scalar


class Spread(NamedTuple):
    """mu_v and sigma_v of eq. (15): moments of the nets' difference on the validation split, for each step."""

    mean: Float[Array | np.ndarray, " n"]
    std: Float[Array | np.ndarray, " n"]


def accuracy(
    goal: Float[Array, "*batch u v 3"], outcome: ProbabilisticMesh, span: Range | None = None
) -> Float[Array, "*batch"]:
    """An accuracy term of eq. (13), or the plain NLL of single-net planning if `span` is None.

    The goal must be whitened.
    """
    loss = nll(goal, whiten_probabilistic(outcome))
    return loss if span is None else (loss - span.low) / (span.high - span.low)


def accuracy_of_each(
    goals: Float[Array, "goals u v 3"], outcome: ProbabilisticMesh, span: Range | None = None
) -> Float[Array, "strains goals"]:
    """`accuracy` of every outcome of a batch for every one of several whitened goals.

    The squared differences are expanded, so that two matrix products compute all pairs.
    """
    outcome = whiten_probabilistic(outcome)
    count = len(outcome.std)
    precision = 1 / jnp.asarray(outcome.std).reshape(count, -1) ** 2
    mean, flat = jnp.asarray(outcome.mean).reshape(count, -1), goals.reshape(len(goals), -1)
    squares = precision @ (flat**2).T - 2 * (mean * precision) @ flat.T + jnp.sum(mean**2 * precision, 1, keepdims=True)
    constant = 0.5 * jnp.log(2 * jnp.pi) - 0.5 * jnp.mean(jnp.log(precision), axis=1, keepdims=True)
    loss = 0.5 * squares / flat.shape[1] + constant
    return loss if span is None else (loss - span.low) / (span.high - span.low)


def diff(a: ProbabilisticMesh, b: ProbabilisticMesh) -> Float[Array, "*batch"]:
    """diff of eq. (15): the mean squared difference of two predictions over all six channels, whitened."""
    a, b = whiten_probabilistic(a), whiten_probabilistic(b)
    # Half of the mean of the sum is the mean over all six channels.
    squared = (a.mean - b.mean) ** 2 + (a.std - b.std) ** 2
    return jnp.mean(squared, axis=(-3, -2, -1)) / 2


def uncertainty(
    differences: Float[Array, "n *batch"], spread: Spread, *, beta: Scalar, gamma: Scalar
) -> Float[Array, "*batch"]:
    """u of eq. (15), from the values of `diff` at each of n steps."""
    shape = (-1,) + (1,) * (differences.ndim - 1)
    u_i = (differences - spread.mean.reshape(shape)) / spread.std.reshape(shape)
    return jnp.mean(bounded_exp(beta * (u_i - gamma)), axis=0)


def bounded_exp(x: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """e^x up to `LARGEST_EXPONENT` and its tangent above: increasing, differentiable and finite (design 6.7)."""
    below = jnp.minimum(x, LARGEST_EXPONENT)
    return jnp.exp(below) * (1 + (x - below))
