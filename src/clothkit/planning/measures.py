"""Measures of epistemic uncertainty: what an ensemble's predictions tell of how wrong they may be.

All are differentiable and have a value per plan and manipulation. A single net differs from no other: its difference
and distance are zero, and its sigma is what is left.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from clothkit.cloth.mesh import ProbabilisticMesh, mean_sigma, smooth_distance
from clothkit.models.ensemble import pairs
from clothkit.planning.mesh_representation import MESH


class Measures(NamedTuple):
    """Measures of predicted meshes; the batch axes are those of the predictions."""

    difference: Float[Array, "*batch"]
    """diff of eq. (15), in the mean over all pairs of nets: squared, whitened, all six channels (no unit)."""
    distance: Float[Array, "*batch"]
    """Mean distance of the nets' means, aligned, in the mean over all pairs [cloth length]."""
    sigma: Float[Array, "*batch"]
    """Root of the mean predicted variance of a vertex's position, over vertices and nets [cloth length]."""


def measure(predictions: Sequence[ProbabilisticMesh]) -> Measures:
    """Return the measures of one prediction per net."""
    variances = [mean_sigma(net) ** 2 for net in predictions]
    sigma = jnp.sqrt(sum(variances[1:], variances[0]) / len(variances))
    apart = [(MESH.difference(a, b), smooth_distance(a.mean, b.mean)) for a, b in pairs(predictions)]
    if not apart:
        return Measures(jnp.zeros_like(sigma), jnp.zeros_like(sigma), sigma)
    difference, distance = (sum(values[1:], values[0]) / len(values) for values in zip(*apart, strict=True))
    return Measures(difference, distance, sigma)
