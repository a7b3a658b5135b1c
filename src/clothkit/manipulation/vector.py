"""The manipulation as a vector of six: u1 v1 u2 v2 (geodesic) dx dy (normalised, Cartesian) (section 4.2.2)."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float
from numpy import ndarray

from clothkit.cloth.grid import CLOTH_SIDE

SHORTEST = 0.35 * CLOTH_SIDE
"""Displacements shorter than this make a null manipulation [normalised]."""

Manipulations = Float[Array, "*batch 6"] | Float[ndarray, "*batch 6"]


def grasp_points(manipulation: Manipulations) -> tuple[Array | ndarray, Array | ndarray]:
    """Both grasp points, geodesic, [*batch, 2] each; the same point twice for one hand."""
    return manipulation[..., 0:2], manipulation[..., 2:4]


def displacement(manipulation: Manipulations) -> Array | ndarray:
    """The displacement vector, Cartesian [normalised], [*batch, 2]."""
    return manipulation[..., 4:6]


def is_null(manipulation: Manipulations) -> Bool[Array, "*batch"]:
    """Whether the displacement is too short for anything to be done (section 4.4, restriction 3)."""
    return jnp.sum(jnp.asarray(displacement(manipulation)) ** 2, axis=-1) < SHORTEST**2


def is_single(manipulation: Manipulations) -> Bool[Array, "*batch"]:
    """Whether one hand does it: both grasp points are the same."""
    first, second = grasp_points(manipulation)
    return jnp.all(jnp.asarray(first) == second, axis=-1)


def swap_grasps(manipulation: Manipulations) -> Float[Array, "*batch 6"]:
    """The same manipulation with its grasp points in the other order (section 4.6, augmentation 3)."""
    return jnp.asarray(manipulation)[..., jnp.array([2, 3, 0, 1, 4, 5])]


def planar(angle: Float[Array, "*batch"], mirrored: Bool[Array, "*batch"]) -> Float[Array, "*batch 2 2"]:
    """The matrix that mirrors x where `mirrored` and then turns by `angle` [rad] about z (augmentation 1)."""
    sign = jnp.where(mirrored, -1.0, 1.0)
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([jnp.stack([c * sign, -s], -1), jnp.stack([s * sign, c], -1)], axis=-2)


def turn_manipulation(
    manipulation: Float[Array, "*batch 6"], matrix: Float[Array, "*batch 2 2"]
) -> Float[Array, "*batch 6"]:
    """The manipulation of the turned or mirrored cloth: labels stay on the cloth, the displacement turns with it."""
    turned = jnp.einsum("...ij,...j->...i", matrix, manipulation[..., 4:6])
    return jnp.concatenate([manipulation[..., :4], turned], axis=-1)


def turn_mesh(mesh: Float[Array, "*batch u v 3"], matrix: Float[Array, "*batch 2 2"]) -> Float[Array, "*batch u v 3"]:
    """The mesh turned or mirrored about z."""
    xy = jnp.einsum("...ij,...uvj->...uvi", matrix, mesh[..., :2])
    return jnp.concatenate([xy, mesh[..., 2:]], axis=-1)
