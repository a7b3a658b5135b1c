"""How far a mesh is from explaining the observed voxels: a term of refinement's loss.

A camera above sees, for each column of voxels, whether it holds cloth and how high the cloth's upper side is. A mesh
explains that if its voxels are those that were seen: no point of it is beside the columns that hold cloth, none is
above the seen height, and each of these columns is *covered*, which means that a point is in its uppermost voxel.
Points are the vertices and the midpoints between them, of which an observation is made, too.

So each point has bounds: a point beside is to be in the nearest column that holds cloth, all are to be below the seen
height, and of the columns that are not covered, each calls the point that is nearest to it into its uppermost voxel. As
the mesh moves, the bounds are found anew every some iterations.
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
"""Share of a column's width by which a point that is pushed into the column goes beyond its border."""


class Columns(NamedTuple):
    """What was seen, by column, row by row."""

    occupied: Bool[Array, "batch columns"]
    low: Float[Array, "batch columns"]
    """Height of the uppermost occupied voxel's lower side [normalised]."""
    high: Float[Array, "batch columns"]
    """Of its upper side."""
    nearest: Int[Array, "batch columns"]
    """The occupied column nearest to each column."""


class Bounds(NamedTuple):
    """Between which coordinates each point of a mesh is to be [normalised]; infinite where it is free."""

    low: Float[Array, "batch points 3"]
    high: Float[Array, "batch points 3"]


def columns(voxels: Shaped[Array | ndarray, "batch x y z"], *, viewport: Viewport = VIEWPORT) -> Columns:
    """The columns of occluded voxels of that viewport."""
    voxels = jnp.asarray(voxels)
    filled = jnp.max((voxels > 0) * jnp.arange(1, voxels.shape[-1] + 1), axis=-1).reshape(len(voxels), -1)
    occupied = filled > 0
    nearest = jnp.argmin(jnp.where(occupied[:, None, :], _AWAY, jnp.inf), axis=-1)
    low, high = (viewport.z(jnp.maximum(filled + side, 0)) for side in (-1.0, 0.0))
    return Columns(occupied, low, high, nearest)


def bounds_of(mesh: Float[Array, "batch u v 3"], seen: Columns, calls: int) -> Bounds:
    """The bounds of a mesh's points. At most `calls` columns call a point, empty ones before those that lack height."""
    points = points_of(mesh)
    column = _column(points)
    home = jnp.take_along_axis(seen.nearest, column, axis=1)
    low, high = _uppermost(seen, home)
    low = jnp.where((home == column)[..., None], -jnp.inf, low).at[..., 2].set(-jnp.inf)
    high = high.at[..., :2].set(jnp.where((home == column)[..., None], jnp.inf, high[..., :2]))

    height = jax.vmap(lambda column, z: jnp.full(len(_MIDDLES), -jnp.inf).at[column].max(z))(column, points[..., 2])
    # Columns that lack the same call in an arbitrary order, and not from one side of the cloth.
    lack = jnp.minimum(seen.low - height, 1.0) + _ARBITRARY
    lack, calling = jax.lax.top_k(jnp.where(seen.occupied & (height < seen.low), lack, 0.0), calls)
    least, greatest = _uppermost(seen, calling)
    # The squared distance of points and targets, without the part that is the same for all points.
    target = (least + greatest) / 2
    away = jnp.sum(points**2, axis=-1)[:, None] - 2 * jnp.einsum("bpk,bck->bcp", points, target)
    nobody = points.shape[1]
    called = jnp.where(lack > 0, jnp.argmin(away, axis=-1), nobody)
    batch = jnp.arange(len(mesh))[:, None]
    return Bounds(low.at[batch, called].set(least, mode="drop"), high.at[batch, called].set(greatest, mode="drop"))


def _uppermost(seen: Columns, column: Int[Array, "batch some"]) -> Bounds:
    """The uppermost occupied voxels of some columns, with a margin in x and y."""
    middle = jnp.asarray(_MIDDLES)[column]
    low, high = (jnp.take_along_axis(side, column, axis=1)[..., None] for side in (seen.low, seen.high))
    return Bounds(*(jnp.concatenate(parts, -1) for parts in ((middle - _HALF, low), (middle + _HALF, high))))


def unexplained(mesh: Float[Array, "batch u v 3"], bounds: Bounds) -> Float[Array, " batch"]:
    """The sum over points of the squared distance to their bounds [normalised²]."""
    points = points_of(mesh)
    beyond = jnp.maximum(0, bounds.low - points) + jnp.maximum(0, points - bounds.high)
    return jnp.sum(beyond**2, axis=(-2, -1))


def points_of(mesh: Float[Array, "batch u v 3"]) -> Float[Array, "batch points 3"]:
    """The points of which an observation of a mesh is made."""
    return double(mesh).reshape(len(mesh), -1, 3)


def _column(points: Float[Array, "batch points 3"]) -> Int[Array, "batch points"]:
    """The column in which each point lies; for points outside the viewport, one at its border."""
    x, y = (jnp.clip(jnp.floor((points[..., k] + 1) / WIDTH).astype(jnp.int32), 0, RESOLUTION[k] - 1) for k in range(2))
    return x * RESOLUTION[1] + y


_HALF = (0.5 - MARGIN) * WIDTH
_MIDDLES = ((np.indices(RESOLUTION[:2]).reshape(2, -1).T + 0.5) * WIDTH - 1).astype(np.float32)
"""Middles xy of the columns [normalised]."""
_AWAY = np.sum((_MIDDLES[:, None] - _MIDDLES) ** 2, axis=-1)
"""Squared distances of the columns from one another."""
_ARBITRARY = np.random.default_rng(0).permutation(len(_MIDDLES)).astype(np.float32) / (10 * len(_MIDDLES))
