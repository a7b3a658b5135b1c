"""Rotation about z and mirroring of meshes and manipulations (section 4.6, augmentation 1)."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


def planar(angle: Float[Array, "*batch"], mirrored: Bool[Array, "*batch"]) -> Float[Array, "*batch 2 2"]:
    """The matrix that reverses x if `mirrored`, and then rotates by `angle` [rad] about z (augmentation 1)."""
    sign = jnp.where(mirrored, -1.0, 1.0)
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([jnp.stack([c * sign, -s], -1), jnp.stack([s * sign, c], -1)], axis=-2)


def turn(xy: Float[Array, "*#batch 2"], matrix: Float[Array, "*#batch 2 2"]) -> Float[Array, "... 2"]:
    """Vectors or points in the plane, transformed by the matrices."""
    # A sum of products, because `matmul` is slow for many tiny matrices.
    x, y = xy[..., 0], xy[..., 1]
    return jnp.stack([matrix[..., i, 0] * x + matrix[..., i, 1] * y for i in range(2)], axis=-1)


def turn_manipulation(
    manipulation: Float[Array, "*batch 6"], matrix: Float[Array, "*batch 2 2"]
) -> Float[Array, "*batch 6"]:
    """The same manipulation of a transformed cloth: geodesic grasp points stay, the displacement is transformed."""
    return jnp.concatenate([manipulation[..., :4], turn(manipulation[..., 4:6], matrix)], axis=-1)


def turn_mesh(mesh: Float[Array, "*batch u v 3"], matrix: Float[Array, "*#batch 2 2"]) -> Float[Array, "*batch u v 3"]:
    """The mesh with x and y transformed by the matrix."""
    xy = turn(mesh[..., :2], matrix[..., None, None, :, :])
    return jnp.concatenate([xy, mesh[..., 2:]], axis=-1)
