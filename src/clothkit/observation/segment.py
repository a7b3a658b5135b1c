"""Separates the points of the cloth from the table's, finds the table's plane, and refuses unsuitable clouds.

A cloth is thinner than a depth camera's noise, so heights can't separate a single layer from the table. There are three
other ways: a mask comes with the cloud; or the points have colours, and the range of the table's colours is given; or
the cloud holds the cloth alone, and the table's plane is given. With a mask or colours, the plane can be found in the
other points.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.cloth.voxels import RESOLUTION
from clothkit.observation.heights import check_lying
from clothkit.observation.plane import Plane, find
from clothkit.observation.settings import CloudConfig
from clothkit.observation.side import Stated, heights_of, oriented
from clothkit.observation.states import PointCloud, named
from clothkit.runtime.errors import InputError

MAX_COVERED = 1.25
"""Largest share of the flat cloth's area that the cloth's points may cover; noise widens the cloth's border."""

_LEAST_POINTS = 100
_UNITS = {"millimetres": 1000.0, "centimetres": 100.0, "inches": 39.37}
# Shares of the cloth's side: least and largest span of a cloth along one axis, folded small or along its diagonal, with
# some slack.
_NARROWEST, _WIDEST = 0.15, 1.6
# No point is an outlier up to this multiple of the mean distance to neighbours. At the corner of an even grid, the
# distance is one and a half times the mean.
_LEAST_OUTLYING = 2.0
# Metres. Some cameras mark points that they did not measure by larger coordinates.
_FARTHEST = 1e5
# Cloth sides. Points further from the median of the cloth's points are strays, if they are few.
_ASTRAY = 20.0
# Share of the points around the cloth from which they count as the table's.
_MOSTLY = 0.6
_BESIDE = 1.5  # cells: reaches the eight cells around a cell
_VOXELS_A_SIDE = CLOTH_LENGTH / 2 * RESOLUTION[0]  # voxels along a side of the flat cloth


class Segmented(NamedTuple):
    """The points of cloth and table in the table's frame [m], and that frame (`Plane.frame`)."""

    cloth: Float[np.ndarray, "cloth 3"]
    """Without outliers and strays."""
    table: Float[np.ndarray, "table 3"]
    """The other points that lie on the table; empty if the cloud holds the cloth alone."""
    rotation: Float[np.ndarray, "3 3"]
    origin: Float[np.ndarray, "3"]


def segment(
    cloud: PointCloud,
    *,
    cloth_side: float,
    settings: CloudConfig,
    table: Plane | None = None,
    stated: Stated = Stated(),  # noqa: B008
    name: str = "cloud",
) -> Segmented:
    """The cloth's points, checked and without outliers, and the table's points, both in the table's frame.

    `cloth_side` is the side of the flat cloth [m]. `stated` is what the user states about the up direction
    (`observation.side`). Raises InputError, one sentence, when there are too few points, their unit is wrong, the table
    isn't found, the side of it that is up can't be decided, the cloth stands upright, or there is a second object.
    """
    kept = _measured(cloud, settings, name)
    points = cloud.points[kept].astype(float)
    mask = _mask(cloud, settings, name)[kept]
    cloth, others = points[mask], points[~mask]
    if len(cloth) < _LEAST_POINTS:
        raise InputError(f"{name}: {len(cloth)} points are the cloth's, expected at least {_LEAST_POINTS}")
    _check_units(cloth, cloth_side, masked=len(others) > 0, name=name)
    plane = table or cloud.table
    told = plane is not None
    if plane is None:
        if not len(others):
            raise InputError(
                f"{name}: table not found, nothing tells cloth and table apart; give a mask, the table's colour, or "
                f"the table's plane with a cloud of the cloth alone{_besides(cloud)}"
            )
        plane = find(others, settings.plane, name=name)
    # Every n-th point, so that points in a camera's rows and columns stay evenly spaced.
    thinned = slice(None, None, -(-len(cloth) // settings.most))
    near = settings.plane.tolerance
    heights = heights_of(plane, cloth[thinned], others, patch=cloth_side / _VOXELS_A_SIDE, flat=near)
    if abs(heights.middle) > settings.highest:
        raise _off_table(heights.middle, name)
    plane = oriented(plane, heights, stated=stated, viewpoint=cloud.viewpoint, told=told, near=near, name=name)
    rotation, origin = plane.frame()
    cloth, others = ((part - origin) @ rotation.T for part in (cloth, others))
    cloth = cloth[thinned]
    if told:
        _check_told(others, cloth, cloth_side, settings, name)
    check_lying(name, cloth, side=cloth_side, remedy="check the table's plane, or say which way is up (--up)")
    cloth = _above_table(cloth, settings, name)
    cloth = _without_strays(cloth, cloth_side, settings)
    cloth = without_outliers(cloth, settings)
    cloth = _one_piece(cloth, cloth_side, settings, name)
    flat = others[np.abs(others[:, 2]) < settings.plane.tolerance]
    return Segmented(cloth, flat, rotation, origin)


def _measured(cloud: PointCloud, settings: CloudConfig, name: str) -> Bool[np.ndarray, " points"]:
    """The mask of the points that the camera measured and that lie in the box. Raises InputError if there are none."""
    if not len(cloud.points):
        raise InputError(f"{name}: is empty, expected points x y z in metres; the camera's view may be")
    for field in ("cloth", "colours"):
        values = getattr(cloud, field)
        if values is not None and len(values) != len(cloud.points):
            raise InputError(f"{name}: {field} has {len(values)} rows for {len(cloud.points)} points")
    with np.errstate(invalid="ignore"):
        kept = (np.abs(cloud.points) < _FARTHEST).all(1) & (cloud.points != 0).any(1)
    if not kept.any():
        raise InputError(f"{name}: is an empty view, none of its {len(kept)} points is finite and other than (0, 0, 0)")
    if settings.box is not None:
        low, high = settings.box
        with np.errstate(invalid="ignore"):
            kept &= ((cloud.points >= low) & (cloud.points <= high)).all(1)
        if not kept.any():
            raise InputError(f"{name}: none of its points lies in the box {low}..{high}")
    return kept


def _mask(cloud: PointCloud, settings: CloudConfig, name: str) -> Bool[np.ndarray, " points"]:
    """The mask of the cloth's points: the cloud's own mask, else from the points' colours, else all points."""
    if cloud.cloth is not None:
        return cloud.cloth
    if settings.table_colour is None:
        return np.ones(len(cloud.points), bool)
    if cloud.colours is None:
        raise InputError(f"{name}: has no colours, but table_colour is to tell the table by them{_besides(cloud)}")
    low, high = settings.table_colour
    return np.any((cloud.colours < np.array(low)) | (cloud.colours > np.array(high)), axis=1)


def _check_units(cloth: np.ndarray, cloth_side: float, *, masked: bool, name: str) -> None:
    """Raises InputError when the cloth's points span more or less than a cloth of that side can."""
    # Percentiles, because a few strays may lie anywhere.
    low, high = np.percentile(cloth, [1, 99], axis=0)
    span = float((high - low).max())
    narrowest, widest = _NARROWEST * cloth_side, _WIDEST * cloth_side
    if narrowest <= span <= widest:
        return
    sentence = (
        f"{name}: the cloth spans {span:.3g} m, a cloth whose longer side is {cloth_side:g} m spans {narrowest:.3g} to "
        f"{widest:.3g} m, slack included"
    )
    units = [unit for unit, factor in _UNITS.items() if narrowest <= span / factor <= widest]
    if units:
        raise InputError(f"{sentence}; the points seem to be in {units[0]}, expected metres")
    if span > widest and not masked:
        raise InputError(f"{sentence}; if the table is among the points, give a mask or the table's colour")
    raise InputError(f"{sentence}; check the units, the cloth's side, and which points are the cloth's")


def _check_told(others: np.ndarray, cloth: np.ndarray, cloth_side: float, settings: CloudConfig, name: str) -> None:
    """Raises InputError when a plane around the cloth is seen that lies beside the table's plane that was told."""
    tolerance = settings.plane.tolerance
    around = np.abs(others[:, :2] - np.median(cloth[:, :2], axis=0)).max(1) < cloth_side
    heights = others[around & (np.abs(others[:, 2]) < settings.highest), 2]
    if len(heights) < _LEAST_POINTS:
        return
    middle = float(np.median(heights))
    seen, expected = ((np.abs(heights - height) < tolerance).mean() for height in (middle, 0.0))
    if abs(middle) > tolerance and seen > _MOSTLY and expected < 1 - _MOSTLY:
        raise InputError(
            f"{name}: the points around the cloth lie {1000 * abs(middle):.0f} mm {'above' if middle > 0 else 'below'} "
            f"the table's plane, expected at most {1000 * tolerance:.0f} mm; check the plane, or leave it out: it is "
            "found in these points"
        )


def _above_table(cloth: np.ndarray, settings: CloudConfig, name: str) -> np.ndarray:
    """The cloth's points between the table and `settings.highest`. Raises InputError if their median lies outside."""
    middle = float(np.median(cloth[:, 2]))
    if not -settings.plane.tolerance <= middle <= settings.highest:
        raise _off_table(middle, name)
    return cloth[(cloth[:, 2] > -2 * settings.plane.tolerance) & (cloth[:, 2] < settings.highest)]


def _off_table(middle: float, name: str) -> InputError:
    return InputError(
        f"{name}: table not found where the cloth lies, half of its points are more than {abs(middle):.3g} m "
        f"{'above' if middle > 0 else 'below'} the plane; check the table's plane, or crop with box"
    )


def _without_strays(cloth: np.ndarray, cloth_side: float, settings: CloudConfig) -> np.ndarray:
    """The points without those that are far from the cloth, if these are too few to be another object.

    Otherwise a few distant points would distort the mean distance by which outliers are found.
    """
    astray = (np.abs(cloth - np.median(cloth, axis=0)) > _ASTRAY * cloth_side).any(1)
    return cloth[~astray] if 0 < astray.mean() < settings.second else cloth


def without_outliers(points: Float[np.ndarray, "points 3"], settings: CloudConfig) -> Float[np.ndarray, "kept 3"]:
    """The points whose mean distance to their nearest neighbours is not far above the cloud's mean of it."""
    if not settings.neighbours or len(points) <= settings.neighbours:
        return points
    distance = cKDTree(points).query(points, k=settings.neighbours + 1)[0][:, 1:].mean(1)
    usual = distance.mean()
    return points[distance <= max(usual + settings.deviations * distance.std(), _LEAST_OUTLYING * usual)]


def _one_piece(cloth: np.ndarray, cloth_side: float, settings: CloudConfig, name: str) -> np.ndarray:
    """The points of the largest connected piece.

    Raises InputError when another piece is too large to be strays, or the largest one is larger than the cloth can be.
    """
    cell = cloth_side / _VOXELS_A_SIDE
    index = np.floor((cloth[:, :2] - cloth[:, :2].min(0)) / cell)
    # Only cells that hold points are stored: the size of a raster would grow with the distance of stray points.
    cells, inverse = np.unique(index[:, 0] + 1j * index[:, 1], return_inverse=True)
    pairs = cKDTree(np.stack([cells.real, cells.imag], axis=-1)).query_pairs(_BESIDE, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs), bool), pairs.T), shape=(len(cells), len(cells)))
    pieces = connected_components(graph, directed=False)[1]
    sizes = np.bincount(pieces)
    largest = int(sizes.argmax())
    second = float(np.sort(sizes)[-2] / sizes[largest]) if len(sizes) > 1 else 0.0
    if second >= settings.second:
        raise InputError(
            f"{name}: two objects where one cloth was expected, the smaller covers {second:.0%} of what the larger "
            "does; crop with box or mask the other"
        )
    cloth = cloth[pieces[inverse] == largest]
    span, area = float(np.ptp(cloth[:, :2], axis=0).max()), sizes[largest] * cell**2
    # Cells at the border count in full, though the cloth covers only a part of them.
    most = MAX_COVERED * (cloth_side + 2 * cell) ** 2
    if span > _WIDEST * cloth_side or area > most:
        raise InputError(
            f"{name}: what should be the cloth spans {span:.2g} m and covers {area:.2g} m², more than a cloth of side "
            f"{cloth_side:g} m can; check its side, and which points are the cloth's"
        )
    return cloth


def _besides(cloud: PointCloud) -> str:
    """The end of a message about missing data: the names of arrays in the cloud's file that are not known."""
    return f"; its file has {named(cloud.unread)}, expected colours, cloth" if cloud.unread else ""
