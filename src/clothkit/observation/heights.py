"""A cloth's heights, held against what a cloth on a table can have and against the viewport in which nets see it."""

import numpy as np
from jaxtyping import Bool, Float

from clothkit.cloth.voxels import RESOLUTION
from clothkit.errors import InputError

MESH_REMEDY = "meshes have z up and the table at 0 (in GLB y is up); if an OBJ or PLY has y up, --y-up turns it"
"""How a sentence ends that refuses a mesh for how it stands."""
MOST_CLAMPED = 0.02
"""Share of the points, or columns, that may lie outside the viewport in z without a notice."""
# Of the cloth's side: real towels, folded twice or crumpled, lie up to 0.28 high, and wider than high.
_TALL = 0.15
_TALLEST = 0.45
_BELOW = 0.005
_LOPSIDED = 2.0
_MOST_BELOW = 0.1
"""Share of the points that may lie below the table by more than a voxel: borders of a mask show what is beside it."""
# Of the columns: of a cloth that lies, few reach the viewport's upper end.
_MOST_AT_TOP = 0.9


def check_lying(name: str, points: Float[np.ndarray, "points 3"], *, side: float, remedy: str) -> None:
    """That a cloth of `side` lies and does not stand; z is up. Any one length unit.

    `remedy` ends the sentence of the InputError that is raised when it stands: it is high, and higher than it is wide.
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
    """That a cloth of `side` does not lie below z = 0. Any one length unit.

    `remedy` ends the sentence of the InputError that is raised when it lies there, by more than what is rounding.
    """
    if not len(points):
        return
    low, high = np.percentile(points[:, 2], [5, 95]) / side
    if low < -_BELOW and -low > _LOPSIDED * max(high, 0.0):
        raise InputError(f"{name}: the cloth lies below its table, down to {low:.3f} of its side; {remedy}")


def clamped(points: Float[np.ndarray, "points 3"], *, height: float) -> float:
    """The share of points [normalised] that lie higher than a viewport of that height, and that voxels show lower."""
    return float((points[:, 2] >= height).mean()) if len(points) else 0.0


def notices_of_points(
    name: str, points: Float[np.ndarray, "points 3"], *, height: float, metres: float
) -> tuple[str, ...]:
    """What should be said of points [normalised] that the viewport does not hold; `metres` per normalised unit."""
    above, said = clamped(points, height=height), []
    below = float((points[:, 2] < -height / RESOLUTION[2]).mean()) if len(points) else 0.0
    if above > MOST_CLAMPED:
        said.append(
            f"{name}: {above:.0%} of the cloth lies higher than nets see, whose viewport ends "
            f"{1000 * height * metres:.0f} mm above the table; it is taken to be no higher than that"
        )
    if below > _MOST_BELOW:
        said.append(
            f"{name}: {below:.0%} of the cloth lies below the table and is taken to lie on it; check the table's plane"
        )
    return tuple(said)


def notices_of_voxels(name: str, voxels: Bool[np.ndarray, "32 32 16"]) -> tuple[str, ...]:
    """What should be said of voxels whose columns reach the viewport's upper end: they may be cut off.

    Raises InputError when almost all of them do, as those of a cloth that stands upright.
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
