"""The area that measured points cover, seen from above: silhouette, centre, overlap with a goal (section 6.5)."""

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.spatial import cKDTree

from clothkit.cloth.silhouette import iou, pixel_centres, silhouette

EXTENT = 1.1
FINEST = 256
"""Most pixels per side, as many as a silhouette in `cloth.silhouette` has; sparse points get fewer."""
_COARSEST = 32
_SPACINGS_PER_PIXEL = 1.5
_SAMPLE = 2000
_NEIGHBOURS = 12


def spacing(xy: Float[np.ndarray, "points 2"]) -> float:
    """The typical distance between points, in their unit: the spacing of a square grid of the same density."""
    some = xy[:: max(1, len(xy) // _SAMPLE)]
    reached = min(_NEIGHBOURS, len(xy) - 1)
    # A disc with the distance to the k-th nearest point as radius holds k points. This varies less than the distance
    # to the nearest point.
    radius = np.median(cKDTree(xy).query(some, k=[reached + 1])[0])
    return max(float(radius) * np.sqrt(np.pi / max(reached, 1)), 1e-9)


def resolution_for(xy: Float[np.ndarray, "points 2"], extent: float) -> int:
    """Pixels per side of a raster of the square -extent..extent in which gaps between points don't show.

    A pixel is one and a half times as wide as the points' spacing. The result is limited to 32..256.
    """
    return int(np.clip(2 * extent / (_SPACINGS_PER_PIXEL * spacing(xy)), _COARSEST, FINEST))


def covered(xy: Float[np.ndarray, "points 2"], *, resolution: int, extent: float = EXTENT) -> Bool[np.ndarray, "x y"]:
    """The mask of the pixels of the square -extent..extent that hold a point, with gaps as small as a pixel closed.

    Points and extent are in one length unit. Pixels are indexed as in `cloth.silhouette.silhouette`.
    """
    pixel = np.floor((xy + extent) * (resolution / (2 * extent)))
    pixel = pixel[((pixel >= 0) & (pixel < resolution)).all(1)].astype(int)
    image = np.zeros((resolution + 2, resolution + 2), bool)
    image[pixel[:, 0] + 1, pixel[:, 1] + 1] = True
    return ndimage.binary_closing(image, structure=np.ones((3, 3)))[1:-1, 1:-1]


def centre(xy: Float[np.ndarray, "points 2"], *, extent: float) -> Float[np.ndarray, "2"]:
    """Mean x, y over the pixels that points cover, in the points' unit. Uneven density does not change it.

    `extent` is half the side of a square that is large enough for the cloth. The square is centred on the middle of the
    points' bounding box.
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
    """Intersection over union of a goal's silhouette and the area that the outcome's points cover (section 6.5), 0..1.

    Goal and points are normalised and centred.
    """
    resolution = resolution_for(points[:, :2], extent)
    return iou(
        silhouette(goal, resolution=resolution, extent=extent),
        covered(points[:, :2], resolution=resolution, extent=extent),
    )
