"""Geometry of manipulations: geodesic and Cartesian points, release points (eq. 1), circular arcs (section 4.2.2)."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from clothkit.cloth.topology import geodesic

HEIGHT_LIMIT = 0.2
"""A release point is min(0.2, k / 2) above its grasp point, where k is their horizontal distance [normalised]."""


def to_cartesian(
    mesh: Float[Array | np.ndarray, "*batch u v 3"], uv: Float[Array | np.ndarray, "*batch 2"]
) -> Float[Array, "*batch 3"]:
    """The points on the meshes at geodesic coordinates uv, by bilinear interpolation; uv is clipped to -1..1."""
    mesh, uv = jnp.asarray(mesh), jnp.asarray(uv)
    rows, columns = mesh.shape[-3:-1]
    quads = np.array([rows - 1, columns - 1], np.int32)
    position = (jnp.clip(uv, -1, 1) + 1) * (quads / 2).astype(np.float32)
    low = jnp.clip(jnp.floor(position).astype(jnp.int32), 0, quads - 1)
    fraction = position - low
    flat = mesh.reshape(*mesh.shape[:-3], rows * columns, 3)

    def corner(du: int, dv: int) -> Array:
        index = (low[..., 0] + du) * columns + low[..., 1] + dv
        return jnp.take_along_axis(flat, index[..., None, None], axis=-2)[..., 0, :]

    fu, fv = fraction[..., 0:1], fraction[..., 1:2]
    near = corner(0, 0) * (1 - fv) + corner(0, 1) * fv
    far = corner(1, 0) * (1 - fv) + corner(1, 1) * fv
    return near * (1 - fu) + far * fu


def nearest_vertex(mesh: Float[np.ndarray, "u v 3"], xy: Float[np.ndarray, "*points 2"]) -> np.ndarray:
    """Index (row by row) of the vertex nearest to each point in xy, int [*points]; of equals, the topmost."""
    vertices = mesh.reshape(-1, 3)
    squared = ((vertices[:, :2] - xy[..., None, :]) ** 2).sum(-1)
    topmost_first = np.argsort(-vertices[:, 2], kind="stable")
    return topmost_first[np.argmin(squared[..., topmost_first], axis=-1)]


def topmost_vertex(mesh: Float[np.ndarray, "u v 3"], xy: Float[np.ndarray, "2"], *, within: float) -> int:
    """Index of the topmost vertex near a point in xy.

    Vertices count as near if they are at most `within` [unit of the mesh] farther from the point than the nearest one.
    """
    vertices = mesh.reshape(-1, 3)
    reach = np.linalg.norm(vertices[:, :2] - xy, axis=-1)
    close = np.flatnonzero(reach <= reach.min() + within)
    return int(close[np.argmax(vertices[close, 2])])


def to_geodesic(mesh: Float[np.ndarray, "u v 3"], xy: Float[np.ndarray, "*points 2"]) -> Float[np.ndarray, "*points 2"]:
    """The geodesic coordinates of the vertex nearest to each point in xy (section 4.3)."""
    return geodesic(mesh.shape[:2]).reshape(-1, 2)[nearest_vertex(mesh, xy)]


class Release(NamedTuple):
    """Release points in the plane, and whether both grasp points lie on the same side of the line m."""

    points: Float[np.ndarray, "*batch 2 2"] | Float[Array, "*batch 2 2"]
    same_side: np.ndarray | Array


def release_points(
    grasps: Float[Array | np.ndarray, "*batch 2 2"], displacement: Float[Array | np.ndarray, "*batch 2"]
) -> Release:
    """Eq. (1): the two grasp points, mirrored across the line m through p, which is perpendicular to the displacement.

    A one-handed manipulation repeats its grasp point, whose mirror image is the point plus the displacement. Arrays are
    NumPy or JAX, as the arguments are; all lengths are in one unit.
    """
    xp = jnp if isinstance(grasps, Array) or isinstance(displacement, Array) else np
    squared = xp.sum(displacement**2, axis=-1)[..., None]
    p = (grasps[..., 0, :] + grasps[..., 1, :] + displacement) / 2
    along = xp.sum((p[..., None, :] - grasps) * displacement[..., None, :], axis=-1) / xp.maximum(squared, 1e-12)
    same_side = xp.asarray(xp.prod(along, axis=-1) > 0)
    return Release(grasps + 2 * along[..., None] * displacement[..., None, :], same_side)


class Arc(NamedTuple):
    """A circular arc in a vertical plane from a grasp point to a release point; its centre is at the grasp's height.

    `direction` is the unit vector in xy from grasp to release, `radius` is a length, and `angle` [rad] is the angle
    that the arc spans.
    """

    start: Float[np.ndarray, "*batch 3"]
    direction: Float[np.ndarray, "*batch 2"]
    radius: Float[np.ndarray, "*batch"]
    angle: Float[np.ndarray, "*batch"]

    def at(self, progress: float) -> Float[np.ndarray, "*batch 3"]:
        """The point at a share `progress`, 0..1, of the arc's length."""
        phi = self.angle * progress
        forward = (self.radius * (1 - np.cos(phi)))[..., None] * self.direction
        return self.start + np.concatenate([forward, (self.radius * np.sin(phi))[..., None]], axis=-1)


def arc(
    grasp: Float[np.ndarray, "*batch 3"], release: Float[np.ndarray, "*batch 2"], *, height_limit: float = HEIGHT_LIMIT
) -> Arc:
    """The path of a hand (section 4.2.2): from the grasp point up, and down to the release point.

    It ends at `release` in xy and h = min(height_limit, k / 2) above the grasp point, where k is the horizontal
    distance. The circle's centre is at the grasp's height and its radius is (k² + h²) / 2k. All lengths are in the unit
    of `height_limit`.
    """
    offset = release - grasp[..., :2]
    k = np.linalg.norm(offset, axis=-1)
    safe = np.maximum(k, 1e-9)
    h = np.minimum(height_limit, k / 2)
    radius = (k**2 + h**2) / (2 * safe)
    # Since h <= k / 2, the release point is at the top of the circle or past it.
    angle = np.arctan2(h, radius - k)
    return Arc(grasp, offset / safe[..., None], np.asarray(radius), np.asarray(angle))
