"""Compares the vertical order of the layers of two folded cloths (section 6.4)."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from clothkit.cloth.topology import SQUARE, Topology

SLACK = 3
"""Factor on the reach in xy for the other mesh, whose folds are not exactly where the truth's are."""

APART = 4
"""Two vertices nearer to one another along the cloth than this count as one layer [grid steps]."""

COMMON = 0.5
"""Least share of the truth's overlapping pairs that must also overlap in the mesh; otherwise the folds differ."""


def reversed_share(
    mesh: Float[np.ndarray, "u v 3"], truth: Float[np.ndarray, "u v 3"], topology: Topology = SQUARE
) -> float:
    """The share of vertex pairs that lie on one another in both meshes whose order in z differs from the truth's.

    Two vertices of the truth lie on one another if they are at most the larger grid spacing apart in x and y. Both
    meshes must have the same labels. NaN if the truth has no overlapping pairs, or if less than a share COMMON of
    them overlap in the mesh. For example, the value is 1/2 for a cloth that is folded twice if the order of the two
    folds is exchanged: three of the six pairs of layers are reversed.
    """
    reach = max(topology.spacing)
    a, b = (np.asarray(m, np.float64).reshape(-1, 3) for m in (mesh, truth))
    pairs = cKDTree(b[:, :2]).query_pairs(reach, output_type="ndarray")
    u, v = np.divmod(pairs, topology.shape[1])
    far = np.maximum(np.abs(np.diff(u)), np.abs(np.diff(v)))[:, 0] >= APART
    near = np.linalg.norm(np.diff(a[pairs][..., :2], axis=1)[:, 0], axis=-1) <= SLACK * reach
    first, second = pairs[far & near].T
    if len(first) < max(1, COMMON * far.sum()):
        return float("nan")
    return float(np.mean((a[first, 2] > a[second, 2]) != (b[first, 2] > b[second, 2])))
