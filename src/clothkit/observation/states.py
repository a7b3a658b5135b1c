"""What an observed cloth can be: a mesh, voxels, or a point cloud."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, UInt8

from clothkit.observation.plane import Plane
from clothkit.observation.pose import Pose

_TOLD = 8


def named(names: Sequence[str]) -> str:
    """Names as a message has them: the first few of many."""
    return ", ".join(names[:_TOLD]) + (", .." if len(names) > _TOLD else "")


@dataclasses.dataclass(frozen=True)
class MeshState:
    """A cloth whose every vertex is known, and where it lies."""

    mesh: Float[np.ndarray, "32 32 3"]
    """Normalised and centred."""
    centre: Float[np.ndarray, "2"]
    """Where its centre was [normalised], in the file's own frame."""
    scale: float
    """Metres per normalised unit."""
    notices: tuple[str, ...] = ()
    """What should be said of how its file was read, in sentences."""

    @property
    def pose(self) -> Pose:
        """What brings the mesh back to metres where it lay: the file's frame is the table's."""
        return Pose(np.eye(3), np.zeros(3), self.centre.astype(float) * self.scale, self.scale)


@dataclasses.dataclass(frozen=True)
class VoxelState:
    """A cloth of which only the occupied voxels are known; taken as centred."""

    voxels: Bool[np.ndarray, "32 32 16"]
    notices: tuple[str, ...] = ()
    """What should be said of how its file was read, in sentences."""


@dataclasses.dataclass(frozen=True)
class PointCloud:
    """Points that a camera measured, in metres in its own frame or any other, and what else is known of them."""

    points: Float[np.ndarray, "points 3"]
    """Metres. Points that are not finite, or exactly (0, 0, 0), are how cameras mark what they did not see."""
    cloth: Bool[np.ndarray, " _"] | None = None
    """[points]; which points are the cloth's; the others are the table's or anything's."""
    colours: UInt8[np.ndarray, "_ 3"] | None = None
    """[points, 3]; red, green and blue, from which a range can tell the table."""
    viewpoint: Float[np.ndarray, "3"] | None = None
    """Where the camera was [m], in the frame of the points; it tells which side of the table is up."""
    table: Plane | None = None
    """The table, where it is known."""
    surface: bool = False
    """Whether these are points of a mesh, as they are seen from above, and not of a camera."""
    unread: tuple[str, ...] = ()
    """What else its file holds under names that say nothing here."""
    notices: tuple[str, ...] = ()
    """What should be said of how its file was read, in sentences."""
