"""What an episode's observer gets of a cloth, in cloth lengths: vertices, voxels or a depth image.

Vertices are in the world's frame, the origin on the table where the flat cloth's middle was. Voxels are those of a
camera above the cloth, centred, with the place of the centre beside them; what heights they stand for, their viewport
tells. Depth images are of a fixed camera [m].
"""

from typing import Any

import numpy as np
from gymnasium import spaces
from jaxtyping import Float

from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import CLOTH_LENGTH, Topology
from clothkit.cloth.voxels import RESOLUTION, Viewport, observe
from clothkit.observation.camera import CameraConfig, render
from clothkit.runtime.errors import InputError

KINDS = ("vertices", "voxels", "depth")

Mesh = Float[np.ndarray, "u v 3"]


class Observer:
    """Makes observations of one kind."""

    def __init__(
        self,
        kind: str,
        topology: Topology,
        *,
        camera: CameraConfig,
        viewport: Viewport,
        side: float,
        farthest: float,
    ) -> None:
        """`side` is the cloth's [m]; coordinates are clipped to -farthest..farthest [cloth length].

        `camera` is that of depth images, `viewport` that of voxels. Raises InputError for an unknown kind.
        """
        if kind not in KINDS:
            raise InputError(f"observation: expected one of {', '.join(KINDS)}, found {kind!r}")
        self._kind, self._topology, self._camera, self._viewport = kind, topology, camera, viewport
        self._side, self._farthest = side, farthest

    def spaces(self) -> dict[str, spaces.Space[Any]]:
        """The spaces of the cloth's parts of an observation, by name; each has one of the goal, too."""
        camera, most = self._camera, self._farthest
        if self._kind == "vertices":
            return {"cloth": spaces.Box(-most, most, (*self._topology.shape, 3), np.float32)}
        if self._kind == "voxels":
            return {"cloth": spaces.MultiBinary(RESOLUTION), "centre": spaces.Box(-most, most, (2,), np.float32)}
        image = (camera.rows, camera.columns)
        # Nothing is farther away than the table's farthest corner.
        deepest = 2 * (camera.height / np.cos(camera.tilt) + camera.table_side)
        return {"cloth": spaces.Box(0, deepest, image, np.float32), "mask": spaces.MultiBinary(image)}

    def __call__(self, mesh: Mesh) -> dict[str, np.ndarray]:
        """The parts of the observation of a mesh at its place on the table [normalised]."""
        if self._kind == "vertices":
            return {"cloth": self._clipped(mesh)}
        if self._kind == "voxels":
            middle, centre = centred(mesh)
            occupied = np.asarray(observe(middle, viewport=self._viewport))
            return {"cloth": occupied.astype(np.int8), "centre": self._clipped(centre)}
        metres = mesh.astype(float) * (self._side / CLOTH_LENGTH)
        image = render(metres, self._topology.triangles(), self._camera)
        return {"cloth": image.depth.astype(np.float32), "mask": image.cloth.astype(np.int8)}

    def _clipped(self, normalised: np.ndarray) -> np.ndarray:
        return np.clip(normalised / CLOTH_LENGTH, -self._farthest, self._farthest).astype(np.float32)
