"""How near an outcome comes to a named goal, by the measures of the field beside our own."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from clothkit.cloth.topology import CLOTH_LENGTH, Topology
from clothkit.manipulation.named_folds import Folds, layout, plane

FIXED = 1.2
"""Weight of the displacement of what shall stay, as in SoftGym's FoldCloth."""

WITHIN = 1e-5
"""Distance beyond the cloth's edge at which a place still counts as on it; geodesic."""


class Groups(NamedTuple):
    """The points of a cloth that a goal puts together, in pairs."""

    moved: Int[np.ndarray, " pairs"]
    """Vertices that are moved, numbered row by row."""
    still: Float[np.ndarray, "pairs 2"]
    """Where on the cloth each of them comes to lie, at a point that no fold moves; geodesic."""


def groups(topology: Topology, folds: Folds) -> Groups:
    """The pairs of a goal; vertices that come to lie beside the cloth, or on cloth that is moved too, are in none."""
    ideal = layout(topology, folds)
    below = ideal.xy / plane(topology, np.ones(2))
    on_cloth = np.abs(below).max(-1) <= 1 + WITHIN
    still = ~layout(topology, folds, np.clip(below, -1, 1)).moved
    paired = ideal.moved & on_cloth & still
    return Groups(np.flatnonzero(paired), np.clip(below[paired], -1, 1).astype(np.float32))


def softgym(
    outcome: Float[np.ndarray, "u v 3"], flat: Float[np.ndarray, "u v 3"], topology: Topology, folds: Folds
) -> float:
    """The measure of SoftGym's FoldCloth (Lin et al. 2020), of which its reward is the negative [cloth length].

    It is the mean distance of the two groups' pairs, and FIXED times the mean displacement of the group that stays from
    its position in the flat cloth, `flat`, in the same labels and at its place on the table. FoldCloth's groups are the
    two halves of a cloth that is folded in half. Of other goals one group is what is moved, the other the points on
    which it shall come to lie, as far as these stay where they are. NaN if there are none.
    """
    pairs = groups(topology, folds)
    if not len(pairs.moved):
        return float("nan")
    placed = [_at(mesh, pairs.still) for mesh in (outcome, flat)]
    apart = np.linalg.norm(outcome.reshape(-1, 3)[pairs.moved] - placed[0], axis=-1).mean()
    away = np.linalg.norm(placed[0] - placed[1], axis=-1).mean()
    return float((apart + FIXED * away) / CLOTH_LENGTH)


def _at(mesh: Float[np.ndarray, "u v 3"], uv: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points 3"]:
    """Points of the cloth by bilinear interpolation; in NumPy, since each goal has another number of them."""
    position = (uv.T + 1) / 2 * (np.array(mesh.shape[:2]) - 1)[:, None]
    along = [ndimage.map_coordinates(mesh[..., axis], position, order=1, mode="nearest") for axis in range(3)]
    return np.stack(along, axis=-1)
