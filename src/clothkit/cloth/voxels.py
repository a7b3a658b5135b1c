"""Voxels: occupancy of the viewport (-1, -1, 0)..(1, 1, height), with occlusion, doubling and noise (section 4.8)."""

from typing import Annotated

import jax
import jax.numpy as jnp
from annotated_types import Ge, Gt, Le
from jaxtyping import Array, Bool, Float, PRNGKeyArray
from numpy import ndarray

from clothkit.runtime.config import config

RESOLUTION = (32, 32, 16)


@config
class Viewport:
    """The part of space that voxels cover, and how they divide it in z; the defaults are the paper's."""

    height: Annotated[float, Gt(0)] = 0.125
    """Its upper end [normalised]."""
    curve: Annotated[float, Ge(1), Le(4)] = 1.0
    """Voxel k of n begins at (k / n)^curve of the height. Above 1, voxels are finer near the table, where thin layers
    have to be told apart, and coarser in the heaps above."""

    def level(self, z: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Heights [normalised, at least 0] in voxels: k to k + 1 within voxel k."""
        count = RESOLUTION[2]
        return z * (count / self.height) if self.curve == 1 else count * (z / self.height) ** (1 / self.curve)

    def z(self, level: Float[Array, "*batch"] | Float[ndarray, "*batch"]) -> Float[Array, "*batch"]:
        """The inverse of `level`: heights [normalised]."""
        share = jnp.asarray(level) / RESOLUTION[2]
        return self.height * (share if self.curve == 1 else share**self.curve)


VIEWPORT = Viewport()
"""The paper's."""

HEIGHT = VIEWPORT.height
"""Upper end of the paper's viewport [normalised]."""

Points = Float[Array, "*batch points 3"] | Float[ndarray, "*batch points 3"]


def double(mesh: Float[Array | ndarray, "*batch u v 3"]) -> Float[Array, "*batch uu vv 3"]:
    """The mesh with midpoints inserted between neighbouring vertices: 63 x 63 vertices from 32 x 32."""
    mesh = jnp.asarray(mesh)
    for axis in (-3, -2):
        ahead = jax.lax.slice_in_dim(mesh, 1, None, axis=axis)
        behind = jax.lax.slice_in_dim(mesh, 0, -1, axis=axis)
        pairs = jnp.stack([behind, (ahead + behind) / 2], axis=axis)
        shape = list(behind.shape)
        shape[axis] *= 2
        woven = pairs.reshape(shape)
        mesh = jnp.concatenate([woven, jax.lax.slice_in_dim(mesh, -1, None, axis=axis)], axis=axis)
    return mesh


def voxelise(points: Points, *, viewport: Viewport = VIEWPORT) -> Bool[Array, "*batch 32 32 16"]:
    """The voxels that contain at least one point.

    Points outside the viewport in x or y are dropped; in z they are clamped (design 6.14).
    """
    points = jnp.asarray(points)
    batch = points.shape[:-2]
    nx, ny, nz = RESOLUTION
    xy = jnp.floor((points[..., :2] + 1) * (nx / 2)).astype(jnp.int32)
    heights = points[..., 2] if viewport.curve == 1 else jnp.maximum(points[..., 2], 0)
    z = jnp.clip(jnp.floor(viewport.level(heights)).astype(jnp.int32), 0, nz - 1)
    inside = jnp.all((xy >= 0) & (xy < nx), axis=-1)
    cell = jnp.where(inside, (xy[..., 0] * ny + xy[..., 1]) * nz + z, nx * ny * nz)
    rows = cell.reshape(-1, cell.shape[-1])
    occupied = jnp.zeros((rows.shape[0], nx * ny * nz), bool)
    occupied = occupied.at[jnp.arange(rows.shape[0])[:, None], rows].set(True, mode="drop")
    return occupied.reshape(*batch, nx, ny, nz)


def occlude(voxels: Bool[Array, "*batch x y z"]) -> Bool[Array, "*batch x y z"]:
    """Mark all voxels below an occupied one as occupied too, since a camera above can't see them."""
    return jax.lax.cummax(voxels.astype(jnp.int8), axis=voxels.ndim - 1, reverse=True).astype(bool)


def of_mesh(
    mesh: Float[Array | ndarray, "*batch u v 3"], *, viewport: Viewport = VIEWPORT
) -> Bool[Array, "*batch 32 32 16"]:
    """The voxels that contain a vertex, without doubling, noise or occlusion, as compared in tables 4 and 7."""
    mesh = jnp.asarray(mesh)
    return voxelise(mesh.reshape(*mesh.shape[:-3], -1, 3), viewport=viewport)


def observe(
    mesh: Float[Array | ndarray, "*batch u v 3"], *, viewport: Viewport = VIEWPORT
) -> Bool[Array, "*batch 32 32 16"]:
    """The voxels of a mesh as a camera above sees them: doubled, occluded, without noise; the input in evaluations."""
    dense = double(mesh)
    return occlude(voxelise(dense.reshape(*dense.shape[:-3], -1, 3), viewport=viewport))


def observe_noisily(
    mesh: Float[Array | ndarray, "*batch u v 3"],
    *,
    noise: float,
    noise_z: float,
    viewport: Viewport = VIEWPORT,
    key: PRNGKeyArray,
) -> Bool[Array, "*batch 32 32 16"]:
    """Training inputs of section 4.8: points are doubled and duplicated, each copy with its own noise, then occluded.

    `noise` (in x and y) and `noise_z` are standard deviations [normalised].
    """
    dense = double(mesh)
    points = dense.reshape(*dense.shape[:-3], -1, 3)
    scale = jnp.array([noise, noise, noise_z])
    copies = points[..., None, :, :] + scale * jax.random.normal(key, (*points.shape[:-2], 2, *points.shape[-2:]))
    return occlude(voxelise(copies.reshape(*points.shape[:-2], -1, 3), viewport=viewport))
