"""Checks of a cloth's heights: it must lie on its table, and a notice is given if it leaves the nets' viewport."""

import numpy as np
from jaxtyping import Bool, Float

from clothkit.cloth.voxels import Viewport
from clothkit.runtime.errors import InputError

MESH_REMEDY = "meshes have z up and the table at 0 (in GLB y is up); if an OBJ or PLY has y up, --y-up turns it"
"""End of the message about a mesh that stands upright or lies below the table."""
MOST_CLAMPED = 0.02
"""Share of the points, or columns, that may lie outside the viewport in z without a notice."""
# Shares of the cloth's side. Real towels that are folded twice or crumpled are up to 0.28 high, and wider than high.
_TALL = 0.15
_TALLEST = 0.45
_BELOW = 0.005
_LOPSIDED = 2.0
_MOST_BELOW = 0.1
"""Share of the points that may lie more than a voxel below the table without a notice.

Points at the border of a mask often belong to what is beside the cloth.
"""
# Share of the columns. Few columns of a cloth that lies on the table reach the viewport's upper end.
_MOST_AT_TOP = 0.9


def check_lying(name: str, points: Float[np.ndarray, "points 3"], *, side: float, remedy: str) -> None:
    """Raises InputError when a cloth stands upright: it is high and higher than wide, or far too high.

    Points (z up) and the side of the flat cloth are in one length unit. `remedy` ends the message.
    """
    if not len(points):
        return
    low, high = np.percentile(points[:, 2], [5, 95])
    tall = float(high - low) / side
    xy = points[:, :2] - points[:, :2].mean(0)
    across = xy @ np.linalg.eigh(xy.T @ xy)[1][:, 0]
    narrow = float(np.ptp(np.percentile(across, [5, 95]))) / side
    if tall > _TALLEST or (tall > _TALL and tall > narrow):
        raise InputError(
            f"{name}: the cloth stands upright, {tall:.2f} of its side high and {narrow:.2f} wide, expected one that "
            f"lies on the table, z up; {remedy}"
        )


def check_above(name: str, points: Float[np.ndarray, "points 3"], *, side: float, remedy: str) -> None:
    """Raises InputError when a cloth lies below the table, z = 0, by more than rounding explains.

    Points and the side of the flat cloth are in one length unit. `remedy` ends the message.
    """
    if not len(points):
        return
    low, high = np.percentile(points[:, 2], [5, 95]) / side
    if low < -_BELOW and -low > _LOPSIDED * max(high, 0.0):
        raise InputError(f"{name}: the cloth lies below its table, down to {low:.3f} of its side; {remedy}")


def clamped(points: Float[np.ndarray, "points 3"], *, viewport: Viewport) -> float:
    """The share of points [normalised] above a viewport; voxels show them at its upper end."""
    return float((points[:, 2] >= viewport.height).mean()) if len(points) else 0.0


def notices_of_points(
    name: str, points: Float[np.ndarray, "points 3"], *, viewport: Viewport, metres: float
) -> tuple[str, ...]:
    """Notices about points [normalised] above or below the viewport; `metres` is the length of a normalised unit."""
    above, said = clamped(points, viewport=viewport), []
    below = float((points[:, 2] < -float(viewport.z(np.array(1.0)))).mean()) if len(points) else 0.0
    if above > MOST_CLAMPED:
        said.append(
            f"{name}: {above:.0%} of the cloth lies higher than nets see, whose viewport ends "
            f"{1000 * viewport.height * metres:.0f} mm above the table; it is taken to be no higher than that"
        )
    if below > _MOST_BELOW:
        said.append(
            f"{name}: {below:.0%} of the cloth lies below the table and is taken to lie on it; check the table's plane"
        )
    return tuple(said)


def notices_of_voxels(name: str, voxels: Bool[np.ndarray, "32 32 16"]) -> tuple[str, ...]:
    """A notice if many columns of voxels reach the viewport's upper end, where the cloth may be cut off.

    Raises InputError when almost all columns reach it, as for a cloth that stands upright.
    """
    columns = voxels.any(-1)
    share = float(voxels[..., -1].sum() / max(columns.sum(), 1))
    if share > _MOST_AT_TOP:
        raise InputError(
            f"{name}: {share:.0%} of the cloth's columns reach the viewport's upper end, as if it stood upright; "
            "expected a cloth that lies, the last axis of the array up"
        )
    if share <= MOST_CLAMPED:
        return ()
    return (f"{name}: {share:.0%} of the cloth's columns reach the viewport's upper end; what is higher is not seen",)
