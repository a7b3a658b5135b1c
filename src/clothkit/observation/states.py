"""Representations of an observed cloth: a mesh, voxels, a point cloud, or a silhouette."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, UInt8

from clothkit.cloth.voxels import Viewport
from clothkit.observation.plane import Plane
from clothkit.observation.pose import Pose

_TOLD = 8


def named(names: Sequence[str]) -> str:
    """Names for a message, separated by commas; of many names, the first few."""
    return ", ".join(names[:_TOLD]) + (", .." if len(names) > _TOLD else "")


@dataclasses.dataclass(frozen=True)
class MeshState:
    """A cloth as a mesh, and its position."""

    mesh: Float[np.ndarray, "u v 3"]
    """Normalised and centred."""
    centre: Float[np.ndarray, "2"]
    """The mesh's centre in the file's own frame [normalised]."""
    scale: float
    """Metres per normalised unit."""
    notices: tuple[str, ...] = ()
    """Notices for the user about how its file was read, a sentence each."""

    @property
    def pose(self) -> Pose:
        """The pose that maps the mesh to metres at its place in the file; the file's frame is the table's."""
        return Pose(np.eye(3), np.zeros(3), self.centre.astype(float) * self.scale, self.scale)


@dataclasses.dataclass(frozen=True)
class VoxelState:
    """A cloth as occupied voxels of the viewport, which need not be centred."""

    voxels: Bool[np.ndarray, "32 32 16"]
    notices: tuple[str, ...] = ()
    """Notices for the user about how its file was read, a sentence each."""
    viewport: Viewport | None = None
    """What they cover; None: not known, and taken to be what the nets know."""


@dataclasses.dataclass(frozen=True)
class PointCloud:
    """Points that a camera measured, in metres in the camera's or any other frame, and their attributes."""

    points: Float[np.ndarray, "points 3"]
    """Metres. Points that are not finite, or exactly (0, 0, 0), were not measured: cameras mark them in this way."""
    cloth: Bool[np.ndarray, " _"] | None = None
    """Mask of the cloth's points [points]; the others belong to the table or to anything else."""
    colours: UInt8[np.ndarray, "_ 3"] | None = None
    """Red, green and blue [points, 3], by which the table's points can be separated from the cloth's."""
    viewpoint: Float[np.ndarray, "3"] | None = None
    """The camera's position in the frame of the points [m]; it decides which side of the table is up."""
    table: Plane | None = None
    """The table's plane, if it is known."""
    surface: bool = False
    """Whether the points were sampled from a mesh as seen from above, and not measured by a camera."""
    unread: tuple[str, ...] = ()
    """Names of other arrays in the file, which were not read."""
    notices: tuple[str, ...] = ()
    """Notices for the user about how its file was read, a sentence each."""


@dataclasses.dataclass(frozen=True)
class SilhouetteState:
    """Which pixels of a picture a cloth covers, and where these look: `pixel` or `intrinsics` is there."""

    pixels: Bool[np.ndarray, "rows columns"]
    pixel: float | None = None
    """Side of a pixel on the table [m], in a picture from straight above."""
    intrinsics: Float[np.ndarray, "3 3"] | None = None
    """The camera's matrix, fx 0 cx, 0 fy cy, 0 0 1 in pixels; the first pixel's centre is at 0, 0."""
    notices: tuple[str, ...] = ()
    """Notices for the user about how its file was read, a sentence each."""
