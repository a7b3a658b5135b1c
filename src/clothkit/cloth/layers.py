"""In which order the layers of a folded cloth lie (section 6.4)."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from clothkit.cloth.grid import CLOTH_SIDE, SIDE

REACH = CLOTH_SIDE / (SIDE - 1)
"""Vertices of the truth that are this near in x and y lie on one another [normalised]."""

SLACK = 3
"""Folds are never quite the truth's: a mesh's vertices lie on one another within so many times REACH."""

APART = 4
"""Vertices this near on the cloth are of one layer [grid steps]."""

COMMON = 0.5
"""Meshes that have a smaller share of the truth's overlaps are folded otherwise, in whatever order."""


def reversed_share(mesh: Float[np.ndarray, "u v 3"], truth: Float[np.ndarray, "u v 3"]) -> float:
    """The share of pairs of vertices, on one another in both meshes, whose order in z is not the truth's.

    Both under the same labels. NaN where the truth has no layers on one another, or the mesh less than COMMON of them.
    One half where a cloth is folded twice, first over the other axis: of six pairs of layers three change places.
    """
    a, b = (np.asarray(m, np.float64).reshape(-1, 3) for m in (mesh, truth))
    pairs = cKDTree(b[:, :2]).query_pairs(REACH, output_type="ndarray")
    u, v = np.divmod(pairs, SIDE)
    far = np.maximum(np.abs(np.diff(u)), np.abs(np.diff(v)))[:, 0] >= APART
    near = np.linalg.norm(np.diff(a[pairs][..., :2], axis=1)[:, 0], axis=-1) <= SLACK * REACH
    first, second = pairs[far & near].T
    if len(first) < max(1, COMMON * far.sum()):
        return float("nan")
    return float(np.mean((a[first, 2] > a[second, 2]) != (b[first, 2] > b[second, 2])))
