"""The points of a cloth of which only a silhouette is known: which pixels of a picture it covers.

A silhouette shows where the cloth lies, but no heights. Its area tells the mean number of layers, the flat cloth's area
over its own, and all points are given the height of a pile of so many.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from clothkit.observation.plane import LEVEL, Plane
from clothkit.observation.states import PointCloud, SilhouetteState
from clothkit.runtime.errors import InputError


class Covered(NamedTuple):
    """The places on the table that the pixels of a silhouette show, and the area that they cover."""

    places: Float[np.ndarray, "pixels 3"]
    """Metres, in the frame of the table's plane."""
    area: float
    """Square metres."""


def points_of(state: SilhouetteState, *, area: float, thickness: float, table: Plane | None, name: str) -> PointCloud:
    """The points in the middle of the uppermost layer of a cloth with this silhouette, if layers were evenly spread.

    `area` is the flat cloth's [m²], `thickness` the distance of the middles of two layers that touch [m]. `table` is
    the table's plane in the camera's frame, which a silhouette seen from straight above does without. Raises
    InputError, in which the silhouette is called `name`, if the plane is not known or a pixel does not show it.
    """
    plane = LEVEL if state.pixel is not None else table
    if plane is None:
        raise InputError(f"{name}: is a silhouette before a camera, expected the table's plane (--table)")
    covered = _from_above(state, state.pixel) if state.pixel is not None else _on_table(state, plane, name)
    layers = max(area / covered.area, 1.0)
    height = (layers - 0.5) * thickness
    notice = f"{name}: is a silhouette, which shows no heights; it is taken for {layers:.1f} layers everywhere"
    return PointCloud(
        covered.places + height * plane.normal,
        viewpoint=None if state.pixel is not None else np.zeros(3),
        table=plane,
        notices=(*state.notices, notice),
    )


def _from_above(state: SilhouetteState, pixel: float) -> Covered:
    """Rows go down in the picture, and so along -y."""
    rows, columns = np.nonzero(state.pixels)
    places = np.stack([columns * pixel, -rows * pixel, np.zeros(len(rows))], axis=-1)
    return Covered(places, len(rows) * pixel**2)


def _on_table(state: SilhouetteState, table: Plane, name: str) -> Covered:
    """Each pixel's ray r = (x, y, 1) meets the plane n p = d at t r with t = d / (n r).

    A pixel that is dx wide and dy high at distance 1 covers the area |t³ / d| dx dy of the plane.
    """
    matrix = state.intrinsics
    if matrix is None:
        raise ValueError("a silhouette has neither pixel nor intrinsics")
    rows, columns = np.nonzero(state.pixels)
    (fx, _, cx), (_, fy, cy) = matrix[:2]
    rays = np.stack([(columns - cx) / fx, (rows - cy) / fy, np.ones(len(rows))], axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = table.offset / (rays @ table.normal)
    if not (np.isfinite(distance).all() and (distance > 0).all()):
        raise InputError(f"{name}: has pixels that do not show the table, check its plane (--table)")
    area = np.sum(distance**3) / abs(table.offset) / (fx * fy)
    return Covered(rays * distance[:, None], float(area))
