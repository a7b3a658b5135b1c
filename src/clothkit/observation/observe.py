"""Voxels and pose of a cloth that is given as a mesh, as voxels or as a point cloud."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.cloth.voxels import RESOLUTION, VIEWPORT, Viewport, double, occlude
from clothkit.cloth.voxels import observe as observe_mesh
from clothkit.observation.cloud import Observation, observe_cloud
from clothkit.observation.heights import (
    MESH_REMEDY,
    check_above,
    check_lying,
    notices_of_points,
    notices_of_voxels,
)
from clothkit.observation.plane import Plane
from clothkit.observation.pose import Pose
from clothkit.observation.settings import CloudConfig
from clothkit.observation.side import Stated
from clothkit.observation.states import MeshState, PointCloud, VoxelState
from clothkit.runtime.errors import InputError


def observe(
    state: MeshState | VoxelState | PointCloud,
    *,
    cloth_side: float,
    settings: CloudConfig = CloudConfig(),  # noqa: B008
    table: Plane | None = None,
    stated: Stated = Stated(),  # noqa: B008
    name: str = "cloud",
) -> Observation:
    """The state as a camera above it sees it: occluded, centred voxels, and the pose that maps plans to metres.

    The resolution of a mesh is doubled as in training. Voxels are shifted by whole voxels so that their centre is in
    the middle; their frame is the table's, with its origin in the middle of the viewport. Raises InputError when a
    cloud does not show a single cloth on a table (`observe_cloud`), a mesh or voxels stand upright, a mesh lies below
    the table, voxels are known to be of another viewport, or don't fit into it once they are centred.
    """
    if isinstance(state, PointCloud):
        return observe_cloud(state, cloth_side=cloth_side, settings=settings, table=table, stated=stated, name=name)
    if isinstance(state, MeshState):
        points = np.asarray(double(state.mesh)).reshape(-1, 3)
        check_lying(name, points, side=CLOTH_LENGTH, remedy=MESH_REMEDY)
        check_above(name, points, side=CLOTH_LENGTH, remedy=MESH_REMEDY)
        notices = notices_of_points(name, points, viewport=settings.viewport, metres=state.scale)
        return Observation(
            np.asarray(observe_mesh(state.mesh, viewport=settings.viewport)), state.pose, points, notices
        )
    if state.viewport not in (None, settings.viewport):
        raise InputError(
            f"{name}: holds voxels of a viewport with {_told(state.viewport)}, expected {_told(settings.viewport)}, "
            "which the nets know"
        )
    notices = notices_of_voxels(name, state.voxels)
    voxels, shift = _centred(np.asarray(occlude(jnp.asarray(state.voxels))), name)
    scale = cloth_side / CLOTH_LENGTH
    pose = Pose(np.eye(3), np.zeros(3), shift * scale, scale)
    return Observation(voxels, pose, _tops(voxels, settings.viewport), notices)


def _told(viewport: Viewport) -> str:
    return f"height {viewport.height:g} and curve {viewport.curve:g}"


def _centred(voxels: Bool[np.ndarray, "32 32 16"], name: str) -> tuple[np.ndarray, np.ndarray]:
    """The voxels shifted by whole voxels to be centred, and the centre that they had [normalised]."""
    columns = voxels.any(-1)
    if not columns.any():
        raise InputError(f"{name}: has no occupied voxel")
    size = np.array(columns.shape)
    steps = np.rint((size - 1) / 2 - np.argwhere(columns).mean(0)).astype(int)
    moved = np.argwhere(voxels) + np.append(steps, 0)
    if (moved < 0).any() or (moved >= voxels.shape).any():
        raise InputError(f"{name}: the cloth does not fit into the viewport once it is centred")
    centred = np.zeros_like(voxels)
    centred[tuple(moved.T)] = True
    return centred, -steps * (2 / size)


def _tops(voxels: Bool[np.ndarray, "32 32 16"], viewport: Viewport = VIEWPORT) -> Float[np.ndarray, "columns 3"]:
    """The middle of the highest occupied voxel of each column that has one [normalised]."""
    x, y = np.nonzero(voxels.any(-1))
    top = voxels[x, y].sum(-1) - 1
    xy = (np.stack([x, y], axis=-1) + 0.5) * (2 / np.array(RESOLUTION[:2])) - 1
    return np.column_stack([xy, np.asarray(viewport.z(top + 0.5))]).astype(np.float32)
