"""Decides which side of the table is up, from the user's statement and the side on which the cloth lies.

A plane has two sides. Seen from the wrong one, a cloth is mirrored and its folds lie below it. A cloth lies on the
visible side of its table, so its heights show the side if they are larger than their errors: noise, and a table that is
not quite flat. The size of these errors is estimated from the distances of the table's patches from the plane.
"""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from clothkit.observation.plane import Plane
from clothkit.runtime.errors import InputError

Evidence = Literal["above", "below", "unknown"]

_LEAST_IN_PATCH = 4
_LEAST_PATCHES = 20
# Metres. A layer of towel is 2 to 5 mm thick; calibrated tables are wrong by 1 or 2 mm.
_SURE = 0.002
_LIKELY = 0.0003
_UNSEEN = 0.001
# Multiples of the deviation of the table's patches.
_SURE_DEVIATIONS = 3.0
# The median of hundreds of patches is more certain than one patch.
_LIKELY_DEVIATIONS = 0.5
# Least ratio of the cloth's heights on one side of the plane to those on the other side.
_LOPSIDED = 2.0
_LEAST_COSINE = 0.5
"""Least cosine of the angle between up and the table's normal: a table may lean, but not stand."""


class Stated(NamedTuple):
    """What the user states about the up direction, in the cloud's frame; None: not stated."""

    up: tuple[float, float, float] | None = None
    """A vector of any length."""
    viewpoint: tuple[float, float, float] | None = None
    """The camera's position [m]; it takes precedence over the cloud's own viewpoint."""


class Heights(NamedTuple):
    """Statistics of the heights of a cloth's patches above a plane [m]; a patch's height is its points' median."""

    low: float
    """5th percentile of the patches."""
    middle: float
    high: float
    """95th percentile."""
    deviation: float
    """Standard deviation of the table's patches from the plane; a usual value where no table was measured."""

    def flipped(self) -> "Heights":
        """The heights above the plane's other side."""
        return Heights(-self.high, -self.middle, -self.low, self.deviation)


def heights_of(
    plane: Plane,
    cloth: Float[np.ndarray, "cloth 3"],
    others: Float[np.ndarray, "others 3"],
    *,
    patch: float,
    flat: float,
) -> Heights:
    """The heights of a cloth's patches above a plane, and the deviation of the table's patches from it.

    The table's points are those of `others` within `flat` of the plane. Patches are `patch` wide. All lengths are in
    metres, all points in the frame in which the plane is given.
    """
    rotation, origin = plane.frame()
    cloth, others = ((part - origin) @ rotation.T for part in (cloth, others))
    heights = _patches(cloth, patch)
    if not len(heights):
        heights = cloth[:, 2]
    table = _patches(others[np.abs(others[:, 2]) < flat], patch)
    deviation = float(np.percentile(np.abs(table), 68)) if len(table) >= _LEAST_PATCHES else _UNSEEN
    low, middle, high = (float(value) for value in np.percentile(heights, [5, 50, 95]))
    return Heights(low, middle, high, deviation)


def evidence(heights: Heights, *, sure: bool) -> Evidence:
    """The side of a plane on which a cloth with these heights lies.

    It is the side to which the cloth rises much farther than to the other. With `sure`, the rise must be more than
    noise, a bent table or a slightly wrong calibration can explain; otherwise the result is the more likely side.
    """
    rise, fall = max(heights.high, 0.0), max(-heights.low, 0.0)
    farthest = max(_SURE, _SURE_DEVIATIONS * heights.deviation)
    if max(rise, fall) > farthest and max(rise, fall) > _LOPSIDED * min(rise, fall):
        return "above" if rise > fall else "below"
    if sure or abs(heights.middle) <= max(_LIKELY, _LIKELY_DEVIATIONS * heights.deviation):
        return "unknown"
    return "above" if heights.middle > 0 else "below"


def oriented(
    plane: Plane,
    heights: Heights,
    *,
    stated: Stated,
    viewpoint: Float[np.ndarray, "3"] | None,
    told: bool,
    near: float,
    name: str,
) -> Plane:
    """The plane with its normal pointing up.

    The first of these that is given decides: `stated.up`; the viewpoint (`stated.viewpoint`, else the cloud's own); the
    normal of the plane, if the plane was given (`told`) and not found in the cloud. If none is given, the origin is
    assumed to be the camera, and the cloth must lie on its side of the table. If the origin is within 2 `near` [m] of
    the table, the cloth's heights alone decide.

    Raises InputError when these contradict one another or the cloth, and when nothing decides.
    """
    if stated.up is not None:
        return _checked(_towards(plane, stated.up, name), plane, heights, "up", name)
    seen_from = None if viewpoint is None else np.asarray(viewpoint, float)
    if stated.viewpoint is not None:
        seen_from = np.array(stated.viewpoint, float)
    if seen_from is not None:
        side = float(plane.heights(seen_from))
        # `not >=` instead of `<`, so that NaN is refused, too.
        if not abs(side) >= 2 * near:
            raise InputError(
                f"{name}: the viewpoint lies in the table, so no side is up; mend it, or say which way is up (--up)"
            )
        if told and side < 0:
            raise InputError(
                f"{name}: the viewpoint is {-side:.3g} m below the table, whose normal should point up; turn the "
                "normal (and offset) round, mend the viewpoint, or say which way is up (--up)"
            )
        return _checked(plane if side > 0 else _turned(plane), plane, heights, "the viewpoint", name)
    side = float(plane.heights(np.zeros(3)))
    if told:
        _checked(plane, plane, heights, "the table's normal", name)
        if side <= -2 * near and evidence(heights, sure=False) != "above":
            raise InputError(
                f"{name}: the table's normal points away from the origin, where a camera's frame has its camera, and "
                "the cloth is too flat to tell which side is up; say it (--up, or --viewpoint)"
            )
        return plane
    towards = plane if side > 0 else _turned(plane)
    found = evidence(heights if side > 0 else heights.flipped(), sure=False)
    if abs(side) < 2 * near:
        if found == "unknown":
            raise InputError(
                f"{name}: the origin lies in the table and the cloth is too flat to tell which side is up; say it "
                "(--up, or --viewpoint)"
            )
        return towards if found == "above" else _turned(towards)
    if found == "below":
        raise InputError(
            f"{name}: the cloth lies on the side of the table that the origin, taken for the camera, does not see; "
            "say which way is up (--up, or --viewpoint)"
        )
    if found == "unknown":
        raise InputError(
            f"{name}: the cloth is too flat to tell which side of the table is up; say it (--up, or --viewpoint: "
            "0 0 0 if the camera is at the origin of the points)"
        )
    return towards


def _checked(up: Plane, plane: Plane, heights: Heights, by: str, name: str) -> Plane:
    """The plane `up`, whose normal points up. Raises InputError when the cloth surely lies below it."""
    found = heights if up is plane else heights.flipped()
    if evidence(found, sure=True) == "below":
        raise InputError(
            f"{name}: the cloth lies below its table, down to {-1000 * found.low:.1f} mm, where {by} tells which side "
            "is up; check it and the table's plane, or say which way is up (--up, or --viewpoint)"
        )
    return up


def _towards(plane: Plane, up: tuple[float, float, float], name: str) -> Plane:
    vector = np.array(up, float)
    length = np.linalg.norm(vector)
    if not (np.isfinite(vector).all() and length > 0):
        raise InputError(f"up {up}: expected three finite numbers, not all 0")
    cosine = float(plane.normal @ vector / length)
    if abs(cosine) < _LEAST_COSINE:
        raise InputError(
            f"{name}: up leans {np.degrees(np.arccos(abs(cosine))):.0f} degrees from the table's normal, expected at "
            f"most {np.degrees(np.arccos(_LEAST_COSINE)):.0f}; check up and the table's plane"
        )
    return plane if cosine > 0 else _turned(plane)


def _turned(plane: Plane) -> Plane:
    return Plane(-plane.normal, -plane.offset)


def _patches(points: np.ndarray, width: float) -> Float[np.ndarray, " patches"]:
    """The median height of each patch that holds enough points."""
    if not len(points):
        return np.zeros(0)
    index = np.floor(points[:, :2] / width).astype(np.int64)
    order = np.lexsort((points[:, 2], index[:, 1], index[:, 0]))
    index, heights = index[order], points[order, 2]
    first = np.flatnonzero(np.r_[True, (np.diff(index, axis=0) != 0).any(1)])
    counts = np.diff(np.r_[first, len(index)])
    enough = counts >= _LEAST_IN_PATCH
    # Points are sorted by height within each patch, so the median is in the middle.
    return heights[(first + counts // 2)[enough]]
