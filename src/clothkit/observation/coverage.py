"""What measured points cover, seen from above: their silhouette, its centre, its overlap with a goal (section 6.5)."""

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.spatial import cKDTree

from clothkit.cloth.silhouette import iou, pixel_centres, silhouette

EXTENT = 1.1
FINEST = 256
"""Pixels a side that a cloth's silhouette has elsewhere; fewer where points are too sparse for them."""
_COARSEST = 32
_SPACINGS_PER_PIXEL = 1.5
_SAMPLE = 2000
_NEIGHBOURS = 12


def spacing(xy: Float[np.ndarray, "points 2"]) -> float:
    """How far apart the points usually are: the side of the square that each would have for itself in a grid."""
    some = xy[:: max(1, len(xy) // _SAMPLE)]
    reached = min(_NEIGHBOURS, len(xy) - 1)
    # The k-th nearest is as far as the radius of a disc that holds k of them: steadier than the nearest.
    radius = np.median(cKDTree(xy).query(some, k=[reached + 1])[0])
    return max(float(radius) * np.sqrt(np.pi / max(reached, 1)), 1e-9)


def resolution_for(xy: Float[np.ndarray, "points 2"], extent: float) -> int:
    """Pixels along the side of a raster that the points' gaps don't show in: pixels of one and a half spacings.

    A pixel is not smaller than 1 / 256 of the square, as `cloth.silhouette` has it.
    """
    return int(np.clip(2 * extent / (_SPACINGS_PER_PIXEL * spacing(xy)), _COARSEST, FINEST))


def covered(xy: Float[np.ndarray, "points 2"], *, resolution: int, extent: float = EXTENT) -> Bool[np.ndarray, "x y"]:
    """The pixels of the square -extent..extent that hold a point, gaps as small as a pixel closed. Any one length unit.

    Pixels are indexed as those of `cloth.silhouette.silhouette`.
    """
    pixel = np.floor((xy + extent) * (resolution / (2 * extent)))
    pixel = pixel[((pixel >= 0) & (pixel < resolution)).all(1)].astype(int)
    image = np.zeros((resolution + 2, resolution + 2), bool)
    image[pixel[:, 0] + 1, pixel[:, 1] + 1] = True
    return ndimage.binary_closing(image, structure=np.ones((3, 3)))[1:-1, 1:-1]


def centre(xy: Float[np.ndarray, "points 2"], *, extent: float) -> Float[np.ndarray, "2"]:
    """Mean x, y over the pixels that points cover: uneven density doesn't move it. Any one length unit.

    `extent` is half the side of a square that surely holds the cloth; it is laid around the points' middle.
    """
    middle = (xy.max(0) + xy.min(0)) / 2
    moved = xy - middle
    resolution = resolution_for(moved, extent)
    x, y = np.nonzero(covered(moved, resolution=resolution, extent=extent))
    axis = pixel_centres(resolution, extent)
    return middle + np.array([axis[x].mean(), axis[y].mean()])


def goal_iou(
    goal: Float[np.ndarray, "u v 3"], points: Float[np.ndarray, "points 3"], *, extent: float = EXTENT
) -> float:
    """Intersection over union of a goal's silhouette and of what points of the outcome cover (section 6.5), 0..1.

    Both normalised and centred.
    """
    resolution = resolution_for(points[:, :2], extent)
    return iou(
        silhouette(goal, resolution=resolution, extent=extent),
        covered(points[:, :2], resolution=resolution, extent=extent),
    )
