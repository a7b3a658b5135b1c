"""Meshes and probabilistic meshes: whitening, likelihood and distances (sections 4.2.1, 5.2 and 6)."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int
from numpy import ndarray

from clothkit.cloth.symmetry import among_equal_labellings, equivalents
from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE, Topology

LEAST_SPREAD = 0.005
"""Lower bound of the standard deviation that whitening divides by; that of a flat cloth is zero in z."""

LEAST_DISTANCE = 1e-3
"""Added in squares to the distances of `smooth_distance` [normalised]; a vertex's own radius, so to speak."""

Mesh = Float[Array, "*#batch u v 3"] | Float[ndarray, "*#batch u v 3"]
"""A mesh or a batch of meshes; functions of two meshes broadcast their batch axes."""


Cloth = Float[Array, "... 3"] | Float[ndarray, "... 3"]
"""Sides along u and along v, and thickness, of each cloth of a batch [normalised]."""


class ProbabilisticMesh(NamedTuple):
    """An independent normal distribution for each coordinate of each vertex [normalised]."""

    mean: Float[Array, "*#batch u v 3"] | Float[ndarray, "*#batch u v 3"]
    std: Float[Array, "*#batch u v 3"] | Float[ndarray, "*#batch u v 3"]


def _moments(mesh: Mesh) -> tuple[Array, Array]:
    mean = jnp.mean(mesh, axis=(-3, -2), keepdims=True)
    # The bound is applied before the root, whose gradient at zero is not finite.
    variance = jnp.var(mesh, axis=(-3, -2), keepdims=True)
    return mean, jnp.sqrt(jnp.maximum(variance, LEAST_SPREAD**2))


def whiten(mesh: Mesh) -> Float[Array, "... u v 3"]:
    """w of eq. (13): the mesh, scaled to mean 0 and standard deviation 1 in each Cartesian dimension (no unit)."""
    mean, spread = _moments(mesh)
    return (jnp.asarray(mesh) - mean) / spread


def whiten_probabilistic(mesh: ProbabilisticMesh) -> ProbabilisticMesh:
    """w of eq. (13) for a probabilistic mesh.

    The moments are those of the mean; its standard deviations are divided by the same standard deviation.
    """
    mean, spread = _moments(mesh.mean)
    return ProbabilisticMesh((mesh.mean - mean) / spread, mesh.std / spread)


def coordinate_nll(mesh: Mesh, probabilistic: ProbabilisticMesh) -> Float[Array, "... u v 3"]:
    """Negative log likelihood of each coordinate of a mesh."""
    z = (jnp.asarray(mesh) - probabilistic.mean) / probabilistic.std
    return 0.5 * z**2 + jnp.log(probabilistic.std) + 0.5 * jnp.log(2 * jnp.pi)


def nll(mesh: Mesh, probabilistic: ProbabilisticMesh) -> Float[Array, "..."]:
    """Negative log likelihood of a mesh, averaged over its coordinates (eqs. 8, 12 and 13)."""
    return jnp.mean(coordinate_nll(mesh, probabilistic), axis=(-3, -2, -1))


def distance(a: Mesh, b: Mesh) -> Float[Array, "..."]:
    """Mean Euclidean distance between vertices with the same label [cloth length]."""
    return jnp.mean(jnp.linalg.norm(jnp.asarray(a) - b, axis=-1), axis=(-2, -1)) / CLOTH_LENGTH


def align(mesh: Mesh, target: Mesh) -> Float[Array, "... u v 3"]:
    """The mesh, translated so that its mean 3D offset from the target is zero (section 6.3)."""
    return jnp.asarray(mesh) - jnp.mean(jnp.asarray(mesh) - target, axis=(-3, -2), keepdims=True)


def distance_aligned(a: Mesh, b: Mesh) -> Float[Array, "..."]:
    """`distance` after subtraction of the mean 3D offset [cloth length], as for planning outcomes (section 6.3)."""
    return distance(align(a, b), b)


def mean_sigma(prediction: ProbabilisticMesh) -> Float[Array, "..."]:
    """Root of the mean predicted variance of a vertex's position [cloth length]."""
    return jnp.sqrt(jnp.mean(jnp.sum(jnp.asarray(prediction.std) ** 2, axis=-1), axis=(-2, -1))) / CLOTH_LENGTH


def smooth_distance(mesh: Mesh, target: Mesh) -> Float[Array, "..."]:
    """`distance_aligned`, with a gradient that is finite where vertices coincide [cloth length]."""
    squared = jnp.sum((align(mesh, target) - target) ** 2, axis=-1)
    return jnp.mean(jnp.sqrt(squared + LEAST_DISTANCE**2), axis=(-2, -1)) / CLOTH_LENGTH


def error(
    mesh: Mesh, truth: Mesh, *, aligned: bool = False, topology: Topology = SQUARE, cloth: Cloth | None = None
) -> Float[Array, "..."]:
    """The smallest distance to any of the truth's equivalents [cloth length]; `distance_aligned` if `aligned`.

    With `cloth`, the sides and thickness of each, only equivalents with the same sides count.
    """
    return jnp.min(_to_equivalents(mesh, truth, aligned, topology, cloth), axis=0)


def best_label(
    mesh: Mesh, truth: Mesh, *, aligned: bool = False, topology: Topology = SQUARE, cloth: Cloth | None = None
) -> Int[Array, "..."]:
    """The index k of the truth's equivalent that is nearest to the mesh; for `cloth` see `error`."""
    return jnp.argmin(_to_equivalents(mesh, truth, aligned, topology, cloth), axis=0)


def _to_equivalents(
    mesh: Mesh, truth: Mesh, aligned: bool, topology: Topology, cloth: Cloth | None
) -> Float[Array, "count ..."]:
    measure = distance_aligned if aligned else distance
    away = measure(jnp.asarray(mesh)[None], equivalents(truth, topology))
    return away if cloth is None else among_equal_labellings(away, cloth)
