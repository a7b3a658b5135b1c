"""How far a mesh is from explaining the observed voxels: a term of refinement's loss.

A camera above sees, for each column of voxels, whether it holds cloth and how high the cloth's upper side is. A mesh
explains that if it reaches up to the seen height in every column that holds cloth (it *covers* them), if no vertex is
beside these columns, and if none is above the seen height. Vertices beside or above are pushed back. A column that is
not covered pulls the vertex nearest to it; as there are few of them, only the `pulls` farthest from covered ones count,
and they are found anew every some iterations.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped
from numpy import ndarray

from clothkit.cloth.voxels import RESOLUTION, VIEWPORT, Viewport, double

WIDTH = 2 / RESOLUTION[0]
"""Width of a column [normalised]."""

MARGIN = 0.1
"""Share of a column's width by which a vertex that is pushed into the column goes beyond its border."""


class Columns(NamedTuple):
    """What was seen, by column, row by row."""

    occupied: Bool[Array, "batch columns"]
    top: Float[Array, "batch columns"]
    """Height of the middle of the uppermost occupied voxel [normalised]."""
    low: Float[Array, "batch columns"]
    """Of its lower side."""
    high: Float[Array, "batch columns"]
    """Of its upper side."""
    nearest: Int[Array, "batch columns"]
    """The occupied column nearest to each column."""


class Pulls(NamedTuple):
    """Pairs of a column that is not covered and the vertex that it pulls."""

    column: Int[Array, "batch pulls"]
    vertex: Int[Array, "batch pulls"]
    active: Bool[Array, "batch pulls"]
    """Whether the column is not covered: there may be fewer of them than pairs."""


def columns(voxels: Shaped[Array | ndarray, "batch x y z"], *, viewport: Viewport = VIEWPORT) -> Columns:
    """The columns of occluded voxels of that viewport."""
    voxels = jnp.asarray(voxels)
    filled = jnp.max((voxels > 0) * jnp.arange(1, voxels.shape[-1] + 1), axis=-1).reshape(len(voxels), -1)
    occupied = filled > 0
    away = jnp.sum((_MIDDLES[:, None] - _MIDDLES) ** 2, axis=-1)
    nearest = jnp.argmin(jnp.where(occupied[:, None, :], away, jnp.inf), axis=-1)
    top, low, high = (viewport.z(jnp.maximum(filled + side, 0)) for side in (-0.5, -1.0, 0.0))
    return Columns(occupied, top, low, high, nearest)


def pulls(mesh: Float[Array, "batch u v 3"], seen: Columns, count: int) -> Pulls:
    """The `count` columns that the mesh is farthest from covering, each with the vertex that is nearest to it."""
    batch = len(mesh)
    dense = double(mesh).reshape(batch, -1, 3)
    reached = jax.vmap(lambda column, z: jnp.full(len(_MIDDLES), -jnp.inf).at[column].max(z))(
        _column(dense), dense[..., 2]
    )
    lacking = jnp.where(seen.occupied, jnp.minimum(seen.low - reached, 1.0), -1.0)
    lack, column = jax.lax.top_k(lacking, count)
    vertices = mesh.reshape(batch, 1, -1, 3)
    target = jnp.take_along_axis(seen.top, column, axis=1)[..., None]
    beyond = _beyond(vertices[..., :2] - jnp.asarray(_MIDDLES)[column][:, :, None], _HALF)
    squared = jnp.sum(beyond**2, axis=-1) + (vertices[..., 2] - target) ** 2
    return Pulls(column, jnp.argmin(squared, axis=-1), lack > 0)


def unexplained(mesh: Float[Array, "batch u v 3"], seen: Columns, pulled: Pulls) -> Float[Array, " batch"]:
    """The sum of squared distances [normalised²]: of vertices beside and above what was seen, and of pulled ones."""
    vertices = mesh.reshape(len(mesh), -1, 3)
    nearest = jnp.take_along_axis(seen.nearest, _column(vertices), axis=1)
    beside = _beyond(vertices[..., :2] - jnp.asarray(_MIDDLES)[nearest], _HALF)
    above = jnp.maximum(0, vertices[..., 2] - jnp.take_along_axis(seen.high, nearest, axis=1))
    moved = jnp.take_along_axis(vertices, pulled.vertex[..., None], axis=1)
    away = _beyond(moved[..., :2] - jnp.asarray(_MIDDLES)[pulled.column], _HALF)
    low, high = (jnp.take_along_axis(side, pulled.column, axis=1) for side in (seen.low, seen.high))
    off = jnp.maximum(0, low - moved[..., 2]) + jnp.maximum(0, moved[..., 2] - high)
    uncovered = pulled.active * (jnp.sum(away**2, axis=-1) + off**2)
    return jnp.sum(beside**2, axis=(-2, -1)) + jnp.sum(above**2, axis=-1) + jnp.sum(uncovered, axis=-1)


def _column(points: Float[Array, "batch points 3"]) -> Int[Array, "batch points"]:
    """The column in which each point lies; for points outside the viewport, one at its border."""
    x, y = (jnp.clip(jnp.floor((points[..., k] + 1) / WIDTH).astype(jnp.int32), 0, RESOLUTION[k] - 1) for k in range(2))
    return x * RESOLUTION[1] + y


def _beyond(offset: Float[Array, "..."], half: float) -> Float[Array, "..."]:
    """How far each offset is beyond -half..half."""
    return jnp.sign(offset) * jnp.maximum(0, jnp.abs(offset) - half)


_HALF = (0.5 - MARGIN) * WIDTH
_MIDDLES = ((np.indices(RESOLUTION[:2]).reshape(2, -1).T + 0.5) * WIDTH - 1).astype(np.float32)
"""Middles xy of the columns [normalised]."""
