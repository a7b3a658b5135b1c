"""Converts a point cloud to the voxels that nets take, and the pose that maps plans to metres (section 6.5).

The cloud is cropped to the table, cleared of outliers, scaled by the cloth's known side, centred, voxelised and
occluded as in training. A camera's points are noisier than a mesh's vertices and uneven in density, so there are three
more steps: heights are smoothed, columns with very few points stay empty, and small gaps are closed.
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.spatial import cKDTree

from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.cloth.voxels import RESOLUTION, VIEWPORT, Viewport, occlude, voxelise
from clothkit.observation.coverage import centre, spacing
from clothkit.observation.heights import notices_of_points
from clothkit.observation.plane import Plane
from clothkit.observation.pose import Pose
from clothkit.observation.segment import segment
from clothkit.observation.settings import CloudConfig
from clothkit.observation.side import Stated
from clothkit.observation.states import PointCloud
from clothkit.runtime.errors import InputError

_DIAGONAL = 0.75  # of the cloth's side: half of its diagonal, and some slack
_SMOOTHED_OVER = (9, 64)  # points: fewer reduce noise little, more are slow
_NOWHERE = 9.0  # normalised, outside the viewport


@dataclasses.dataclass(frozen=True)
class Observation:
    """An observed cloth: voxels, pose and points."""

    voxels: Bool[np.ndarray, "32 32 16"]
    """Occluded and centred: the input of `estimation.estimate`."""
    pose: Pose
    """The position of the cloth on the table, and of the table in the camera's frame."""
    points: Float[np.ndarray, "points 3"]
    """The cloth's points, normalised and centred, heights smoothed."""
    notices: tuple[str, ...] = ()
    """Notices for the user, a sentence each: parts of the cloth that the voxels don't show."""


def observe_cloud(
    cloud: PointCloud,
    *,
    cloth_side: float,
    settings: CloudConfig = CloudConfig(),  # noqa: B008
    table: Plane | None = None,
    stated: Stated = Stated(),  # noqa: B008
    name: str = "cloud",
) -> Observation:
    """The voxels and the pose of the cloth in a point cloud.

    `cloth_side` is the side of the flat cloth [m]. The table's plane is `table`, else the cloud's own, else it is
    fitted to the points outside the cloth. `observation.side` decides which side of the plane is up, from `stated`, the
    cloud's viewpoint and the cloth's heights. Messages call the cloud `name`. Raises InputError, one sentence, when the
    cloud does not show a single cloth on a table.
    """
    if not (np.isfinite(cloth_side) and cloth_side > 0):
        raise InputError(f"cloth side {cloth_side:g}: expected metres above 0")
    found = segment(cloud, cloth_side=cloth_side, settings=settings, table=table, stated=stated, name=name)
    middle = centre(found.cloth[:, :2], extent=_DIAGONAL * 2 * cloth_side)
    pose = Pose(found.rotation, found.origin, middle, cloth_side / CLOTH_LENGTH)
    points = found.cloth - [0, 0, settings.surface]
    points = pose.table_to_normalised(smoothed(points, radius=settings.smoothing))
    empty = columns_of(pose.table_to_normalised(found.table)) > 0
    occupied = voxels_of_points(points, covered=settings.covered, viewport=settings.viewport)
    voxels = closed(occupied, ~empty, most=settings.closed)
    notices = notices_of_points(name, points, viewport=settings.viewport, metres=pose.scale)
    return Observation(voxels, pose, points.astype(np.float32), notices)


def smoothed(points: Float[np.ndarray, "points 3"], *, radius: float) -> Float[np.ndarray, "points 3"]:
    """The points, each with its height replaced by the median height of its nearest neighbours in xy.

    The number of neighbours is that of a disc of `radius` at the usual density, limited to 9..64. Points and radius are
    in one length unit; radius 0 changes nothing. A median keeps the steps between layers, which a mean would blur.
    """
    if radius == 0:
        return points
    tree = cKDTree(points[:, :2])
    neighbours = int(np.clip(np.pi * (radius / spacing(points[:, :2])) ** 2, *_SMOOTHED_OVER))
    nearest = tree.query(points[:, :2], k=min(neighbours, len(points)))[1]
    return np.column_stack([points[:, :2], np.median(points[:, 2][nearest].reshape(len(points), -1), axis=1)])


def columns_of(points: Float[np.ndarray, "points 3"]) -> np.ndarray:
    """The number of points [normalised] in each column of voxels, int [32, 32]."""
    edges = [np.linspace(-1, 1, n + 1) for n in RESOLUTION[:2]]
    return np.histogram2d(points[:, 0], points[:, 1], bins=edges)[0].astype(int)


def voxels_of_points(
    points: Float[np.ndarray, "points 3"], *, covered: float = 0.0, viewport: Viewport = VIEWPORT
) -> Bool[np.ndarray, "32 32 16"]:
    """The occluded voxels of points [normalised].

    Columns with fewer points than `covered` times the median of the columns that hold points stay empty.
    """
    counts = columns_of(points)
    least = covered * np.median(counts[counts > 0]) if counts.any() else 0
    # Padded to a power of two, so that JAX compiles for few different shapes.
    padded = np.full((1 << max(len(points) - 1, 1).bit_length(), 3), _NOWHERE, np.float32)
    padded[: len(points)] = points
    voxels = np.asarray(occlude(voxelise(padded, viewport=viewport)))
    return voxels & (counts >= least)[..., None]


def closed(
    voxels: Bool[np.ndarray, "32 32 16"], unseen: Bool[np.ndarray, "32 32"], *, most: int
) -> Bool[np.ndarray, "32 32 16"]:
    """The voxels with gaps of at most `most` columns filled, up to the median height of the columns around them.

    A gap is a connected group of empty columns that cloth surrounds and in none of which the table was measured:
    `unseen` is true in all of them.
    """
    empty = ~voxels[..., 0]
    gaps, count = ndimage.label(empty)
    filled = voxels.copy()
    border = np.unique(np.concatenate([gaps[0], gaps[-1], gaps[:, 0], gaps[:, -1]]))
    for gap in range(1, count + 1):
        inside = gaps == gap
        if gap in border or inside.sum() > most or not unseen[inside].all():
            continue
        around = ndimage.binary_dilation(inside, structure=np.ones((3, 3))) & ~empty
        filled[inside, : int(np.median(voxels[around].sum(-1)))] = True
    return filled
