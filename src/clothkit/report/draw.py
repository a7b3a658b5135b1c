"""Draws cloth from above: two sides in different colours, shading, edges of layers, and the spread of a prediction.

The vertices of a refined mesh are splatted into a depth buffer, and the picture is then reduced: this is fast and gives
smooth edges. The winding of the grid decides between front and back, so two meshes of one shape match in colour if
their labels match.
"""

from functools import cache
from typing import Literal, NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.interpolate import make_interp_spline

from clothkit.cloth.topology import SQUARE, Topology

EXTENT = 1.05
"""Half the side of a picture [normalised]: slightly more than the viewport of the voxels."""

PIXELS = 220
"""Side of a picture [pixels]."""

_OVERSAMPLING = 2
# Points of the refined mesh per grid spacing in a picture of PIXELS: enough that slanted cloth shows no holes.
_FINER = 18
_INDEX_BITS = 24
FRONT = np.array([0.33, 0.53, 0.74], np.float32)
BACK = np.array([0.95, 0.71, 0.38], np.float32)
_SPREAD = np.array([0.66, 0.47, 0.85], np.float32)
# Luminance falls monotonically, so that a print in grey shows the same order.
_RELIEF = np.array(
    [
        [0.99, 0.96, 0.75],
        [0.75, 0.88, 0.62],
        [0.38, 0.74, 0.67],
        [0.16, 0.53, 0.69],
        [0.20, 0.27, 0.55],
        [0.12, 0.05, 0.25],
    ],
    np.float32,
)
# Colours of the corners [u v] of the geodesic texture: distinct hues, light enough for shading.
_CORNERS = np.array(
    [[[0.93, 0.93, 0.60], [0.36, 0.72, 0.55]], [[0.93, 0.52, 0.45], [0.38, 0.40, 0.78]]],
    np.float32,
)
_LIGHT = np.array([-0.45, 0.45, 0.77], np.float32)
# The grid texture's number of squares along a side, and the width of its lines as a share of a square.
_SQUARES, _LINE = 8, 0.09
# Neighbouring pixels show two layers if their grid coordinates differ by more vertices than this.
_LAYER_JUMP = 2.0
# Standard deviations in z [normalised] at which the cast on a cloth's colour begins and reaches its full strength.
_CAST = (0.01, 0.06)

Texture = Literal["plain", "grid", "geodesic"]
"""Texture of a cloth: one colour per side, the same with a grid (not the mesh's), or a gradient over u and v."""


def draw(
    mesh: Float[np.ndarray, "u v 3"],
    *,
    std: Float[np.ndarray, "u v 3"] | None = None,
    table: tuple[float, float, float] = (1.0, 1.0, 1.0),
    texture: Texture = "plain",
    pixels: int = PIXELS,
    topology: Topology = SQUARE,
) -> UInt8[np.ndarray, "row column 3"]:
    """A picture of the cloth from above, of the square -EXTENT..EXTENT, y upwards.

    `table` is the background colour, 0..1. With `std` [normalised], lilac around the cloth shows the standard
    deviations of its vertices in x and y, and a lilac cast on the cloth those in z, as in the paper's figure 3.
    """
    size = pixels * _OVERSAMPLING
    cloth = _splat(mesh, size)
    image = np.broadcast_to(np.array(table, np.float32), (size, size, 3)).copy()
    image *= 1 - 0.28 * _blur(np.roll(cloth.covered, (5, 3), (0, 1)).astype(np.float32), 0.018 * size)[..., None]
    if std is not None:
        halo = _halo(mesh, std, size, topology)[..., None]
        image = image * (1 - halo) + _SPREAD * halo
    colour = _shade(cloth, texture)
    if std is not None:
        cast = np.clip((_refined(std, cloth.finer)[..., 2] - _CAST[0]) / (_CAST[1] - _CAST[0]), 0, 1)
        cast = 0.75 * cast.ravel()[cloth.source][..., None]
        colour = colour * (1 - cast) + _SPREAD * cast
    image = np.where(cloth.covered[..., None], colour, image)
    image *= 1 - 0.62 * _layer_edges(cloth)[..., None]
    reduced = cv2.resize(np.clip(image, 0, 1), (pixels, pixels), interpolation=cv2.INTER_AREA)
    return np.rint(reduced * 255).astype(np.uint8)


def draw_relief(
    mesh: Float[np.ndarray, "u v 3"], *, highest: float, pixels: int = PIXELS
) -> UInt8[np.ndarray, "r c 3"]:
    """A picture of the cloth from above, coloured by height, of the square -EXTENT..EXTENT, y upwards.

    `relief_colours` span heights from the table to `highest` [normalised]; greater heights have the last colour.
    """
    cloth = _splat(mesh, pixels * _OVERSAMPLING)
    share = np.clip(cloth.heights / highest, 0, 1)
    image = np.where(cloth.covered[..., None], relief_colours(share), np.float32(1))
    image = image * (1 - 0.45 * _layer_edges(cloth)[..., None])
    reduced = cv2.resize(image.astype(np.float32), (pixels, pixels), interpolation=cv2.INTER_AREA)
    return np.rint(np.clip(reduced, 0, 1) * 255).astype(np.uint8)


def relief_colours(share: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape 3"]:
    """Colours of heights, which are shares 0..1 of the greatest: from pale yellow over green and blue to near black."""
    stops = np.linspace(0, 1, len(_RELIEF))
    return np.stack([np.interp(share, stops, channel) for channel in _RELIEF.T], axis=-1).astype(np.float32)


def draw_heights(voxels: Bool[np.ndarray, "x y z"], *, pixels: int = PIXELS) -> UInt8[np.ndarray, "row column 3"]:
    """A height map of voxels in the square -EXTENT..EXTENT, y upwards: white is the table, dark is high."""
    nx, ny, nz = voxels.shape
    height = np.where(voxels.any(-1), nz - np.argmax(voxels[..., ::-1], axis=-1), 0) / nz
    axis = ((np.arange(pixels) + 0.5) * (2 * EXTENT / pixels) - EXTENT + 1) / 2
    i, j = np.floor(axis * nx).astype(int), np.floor(axis * ny).astype(int)
    inside = ((i >= 0) & (i < nx))[:, None] & ((j >= 0) & (j < ny))
    sampled = np.where(inside, height[np.clip(i, 0, nx - 1)][:, np.clip(j, 0, ny - 1)], 0)
    grey = np.where(sampled > 0, grey_of_height(sampled), 1.0).T[::-1]
    return np.repeat(np.rint(grey * 255).astype(np.uint8)[..., None], 3, axis=-1)


def grey_of_height(share: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """The grey value of a column of voxels, 1 for white; `share` is its height as a share (0, 1] of the viewport's."""
    return 0.82 - 0.7 * share


def draw_silhouette(mesh: Float[np.ndarray, "u v 3"], *, pixels: int = PIXELS) -> UInt8[np.ndarray, "row column 3"]:
    """A picture of the cloth's projection on the table, in grey, of the square -EXTENT..EXTENT, y upwards."""
    covered = _splat(mesh, pixels * _OVERSAMPLING).covered.astype(np.float32)
    grey = cv2.resize(1 - 0.18 * covered, (pixels, pixels), interpolation=cv2.INTER_AREA)
    return np.repeat(np.rint(grey * 255).astype(np.uint8)[..., None], 3, axis=-1)


class _Cloth(NamedTuple):
    """The refined mesh, the mask of the pixels that show it, and the index of the top vertex at each pixel."""

    fine: Float[np.ndarray, "fu fv 3"]
    finer: int
    """Factor by which the mesh's resolution was increased."""
    covered: Bool[np.ndarray, "row column"]
    source: Int[np.ndarray, "row column"]

    @property
    def heights(self) -> np.ndarray:
        """Height of the top layer at each pixel [normalised], 0 on the table."""
        return np.where(self.covered, self.fine[..., 2].ravel()[self.source], 0)


@cache
def _weights(side: int, finer: int) -> np.ndarray:
    knots = np.arange(side)
    between = np.linspace(0, side - 1, (side - 1) * finer + 1)
    return make_interp_spline(knots, np.eye(side), k=3)(between).astype(np.float32)


def _refined(mesh: np.ndarray, finer: int) -> np.ndarray:
    """The mesh, or any array over its vertices, interpolated by cubic splines to `finer` times its resolution."""
    along_u, along_v = _weights(mesh.shape[0], finer), _weights(mesh.shape[1], finer)
    return np.einsum("fu,uvc,gv->fgc", along_u, np.asarray(mesh, np.float32), along_v, optimize=True)


def _splat(mesh: np.ndarray, size: int) -> _Cloth:
    finer = -(-_FINER * size // (PIXELS * _OVERSAMPLING))
    fine = _refined(mesh, finer)
    column = np.floor((fine[..., 0].ravel() + EXTENT) * (size / (2 * EXTENT))).astype(int)
    row = np.floor((EXTENT - fine[..., 1].ravel()) * (size / (2 * EXTENT))).astype(int)
    shown = np.flatnonzero((column >= 0) & (column < size) & (row >= 0) & (row < size))
    # Vertices are sorted by height, because of several values for one pixel NumPy keeps the last. Sorting integers is
    # several times faster than argsort, and the order of equal heights is the same on all machines.
    height = np.rint(fine[..., 2].ravel()[shown] * 1e6).astype(np.int64)
    upwards = np.sort((height << _INDEX_BITS) | shown) & ((1 << _INDEX_BITS) - 1)
    covered, source = np.zeros((size, size), bool), np.zeros((size, size), int)
    covered[row[upwards], column[upwards]] = True
    source[row[upwards], column[upwards]] = upwards
    return _Cloth(fine, finer, covered, source)


def _shade(cloth: _Cloth, texture: Texture) -> np.ndarray:
    """The lit colour of each pixel that shows cloth; black elsewhere."""
    fine = cloth.fine
    last_u, last_v = fine.shape[0] - 1, fine.shape[1] - 1
    u, v = np.divmod(cloth.source[cloth.covered], fine.shape[1])
    along_u = fine[np.minimum(u + 1, last_u), v] - fine[np.maximum(u - 1, 0), v]
    along_v = fine[u, np.minimum(v + 1, last_v)] - fine[u, np.maximum(v - 1, 0)]
    normal = np.cross(along_u, along_v)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True) + 1e-12
    front = normal[:, 2:] >= 0
    lit = np.clip(np.where(front, normal, -normal) @ _LIGHT, 0, 1)
    # Pixels lower than their surroundings get less light, so that a layer stands out from those below.
    heights = cloth.heights
    hollow = np.clip(_blur(heights, 0.012 * len(heights)) - heights, 0, None)[cloth.covered]
    printed = _printed(u / last_u, v / last_v, front, texture)
    colour = np.clip(printed * (0.42 + 0.75 * lit[:, None]), 0, 1)
    image = np.zeros((*cloth.covered.shape, 3), np.float32)
    image[cloth.covered] = colour * (1 - np.clip(9 * hollow, 0, 0.4))[:, None]
    return image


def _printed(u: np.ndarray, v: np.ndarray, front: np.ndarray, texture: Texture) -> np.ndarray:
    """The texture's colours, without light, at places u, v (0..1) of the cloth; `front` says which side is visible."""
    if texture == "geodesic":
        along_u = np.stack([1 - u, u], -1).astype(np.float32)
        along_v = np.stack([1 - v, v], -1).astype(np.float32)
        return np.einsum("nu,nv,uvc->nc", along_u, along_v, _CORNERS)
    sides = np.where(front, FRONT, BACK)
    if texture == "grid":
        lines = [np.abs(np.round(place * _SQUARES) - place * _SQUARES) < _LINE / 2 for place in (u, v)]
        sides = np.where((lines[0] | lines[1])[:, None], 0.62 * sides, sides)
    return sides


def _layer_edges(cloth: _Cloth) -> np.ndarray:
    """A picture that is 1 at edges between layers and along the cloth's outline, else 0."""
    u, v = np.divmod(cloth.source, cloth.fine.shape[1])
    u, v = (np.where(cloth.covered, place, -100 * cloth.finer) for place in (u, v))
    edge = np.zeros(cloth.covered.shape, np.float32)
    heights = cloth.heights
    for axis in (0, 1):
        jump_u, jump_v = (np.abs(np.roll(place, -1, axis) - place) > _LAYER_JUMP * cloth.finer for place in (u, v))
        jump = jump_u | jump_v
        higher = heights >= np.roll(heights, -1, axis)
        edge[jump & higher & cloth.covered] = 1
        edge[np.roll(jump & ~higher, 1, axis) & cloth.covered] = 1
    return edge


def _halo(mesh: np.ndarray, std: np.ndarray, size: int, topology: Topology) -> np.ndarray:
    """Opacity 0..1 of the spread in x and y. It grows with the expected number of vertices at a pixel."""
    per_pixel = size / (2 * EXTENT)
    sigma = np.sqrt(std[..., 0] * std[..., 1]).ravel() * per_pixel
    levels = np.geomspace(max(sigma.min(), 1.0), max(sigma.max(), 1.01), 8)
    level = np.argmin(np.abs(np.log(np.maximum(sigma, 1e-6))[:, None] - np.log(levels)), axis=1)
    column = np.floor((mesh[..., 0].ravel() + EXTENT) * per_pixel).astype(int)
    row = np.floor((EXTENT - mesh[..., 1].ravel()) * per_pixel).astype(int)
    inside = (column >= 0) & (column < size) & (row >= 0) & (row < size)
    expected = np.zeros((size, size), np.float32)
    for k, width in enumerate(levels):
        chosen = inside & (level == k)
        impulses = np.zeros((size, size), np.float32)
        np.add.at(impulses, (row[chosen], column[chosen]), 1.0)
        expected += _blur(impulses, width)
    # A vertex represents a cell of the cloth as wide as the grid spacings.
    along_u, along_v = (spacing * per_pixel for spacing in topology.spacing)
    return 0.85 * (1 - np.exp(-1.5 * expected * (along_u * along_v)))


def _blur(image: np.ndarray, sigma: float) -> np.ndarray:
    return cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
