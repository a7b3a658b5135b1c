"""Epistemic uncertainty of plans: u of eq. (15), from how far the nets' predictions are apart."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from clothkit.planning.types import Scalar

LARGEST_EXPONENT = 20.0
"""Above this x, e^x in eq. (15) is replaced by its tangent, which is finite in float32 and has a positive slope."""


class Spread(NamedTuple):
    """mu_v and sigma_v of eq. (15): moments of the nets' difference on the validation split, for each step."""

    mean: Float[Array | np.ndarray, " n"]
    std: Float[Array | np.ndarray, " n"]


def uncertainty(
    differences: Float[Array, "n *batch"], spread: Spread, *, beta: Scalar, gamma: Scalar
) -> Float[Array, "*batch"]:
    """u of eq. (15), from the nets' difference after each of n steps."""
    shape = (-1,) + (1,) * (differences.ndim - 1)
    u_i = (differences - spread.mean.reshape(shape)) / spread.std.reshape(shape)
    return jnp.mean(bounded_exp(beta * (u_i - gamma)), axis=0)


def bounded_exp(x: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """e^x up to `LARGEST_EXPONENT` and its tangent above: increasing, differentiable and finite (design 6.7)."""
    below = jnp.minimum(x, LARGEST_EXPONENT)
    return jnp.exp(below) * (1 + (x - below))
