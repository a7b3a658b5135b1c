"""Converts recorded manipulations to the nets' inputs: geodesic grasp points for meshes, Cartesian ones for voxels."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from clothkit.cloth import voxels
from clothkit.models.emd_voxel import cartesian


class Recorded(NamedTuple):
    """Recorded manipulations as a net's input, with the states before the first and after the last manipulation."""

    start: Shaped[np.ndarray, "task *state"]
    plan: Float[np.ndarray, "task n 6"]
    goal: Shaped[np.ndarray, "task *state"]


def in_meshes(states: Float[np.ndarray, "task state u v 3"], plan: Float[np.ndarray, "task n 6"]) -> Recorded:
    """Recorded subsequences as inputs of nets for meshes."""
    return Recorded(states[:, 0], plan, states[:, -1])


def in_voxels(states: Float[np.ndarray, "task state u v 3"], plan: Float[np.ndarray, "task n 6"]) -> Recorded:
    """Recorded subsequences as inputs of nets for voxels: meshes become the voxels that `voxels.observe` returns."""
    seen = [np.asarray(voxels.observe(states[:, i])) for i in (0, -1)]
    return Recorded(seen[0], np.asarray(cartesian(states[:, :-1], plan)), seen[1])
