"""A sensor that is a simulated depth camera above the table (section 6.5)."""

import dataclasses

import jax
import numpy as np
from jaxtyping import Float

from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import Viewport, observe
from clothkit.episodes.sensors import Sensed
from clothkit.observation.picture import PictureConfig, take
from clothkit.planning.perception import Perception
from clothkit.planning.types import Meshes, Observation
from clothkit.runtime.errors import InputError


@dataclasses.dataclass(frozen=True)
class DepthCamera:
    """A simulated depth camera above the table, whose pictures become voxels (section 6.5)."""

    picture: PictureConfig

    def __call__(self, truth: Meshes, expected: Meshes | None) -> Sensed:
        """The voxels of each cloth's picture, and the shifts of the observed centres.

        If a picture shows no cloth, the voxels are those of the expected mesh, or of the flat cloth if nothing is
        expected yet, and the shift is zero.
        """
        voxels, shift = [], np.zeros((len(truth), 2), np.float32)
        # Half of a sequence's sessions begin at one state: a mesh is taken once, since its pictures are all the same.
        taken: dict[bytes, tuple[np.ndarray, np.ndarray] | None] = {}
        for number, mesh in enumerate(truth):
            key = mesh.tobytes()
            if key not in taken:
                taken[key] = self._seen(mesh)
            seen = taken[key]
            if seen is None:
                missing = SQUARE.flat() if expected is None else expected[number]
                voxels.append(np.asarray(_observe(missing, viewport=self.picture.cloud.viewport)))
                continue
            voxels.append(seen[0])
            shift[number] = seen[1]
        return Sensed(Observation(voxels=np.stack(voxels)), shift)

    def _seen(self, mesh: Float[np.ndarray, "u v 3"]) -> tuple[np.ndarray, np.ndarray] | None:
        """The voxels of a mesh's picture and the shift of the observed centre; None if it shows no cloth."""
        try:
            picture = take(mesh, self.picture)
        except InputError:
            return None
        return picture.observation.voxels, picture.shift


def depth_camera(picture: PictureConfig, perception: Perception) -> DepthCamera:
    """A depth camera whose voxels are those that a perception takes."""
    assert perception.viewport is not None, "a perception that takes voxels"
    return DepthCamera(with_viewport(picture, perception.viewport))


def with_viewport(picture: PictureConfig, viewport: Viewport) -> PictureConfig:
    """The camera's settings with voxels of another viewport."""
    return dataclasses.replace(picture, cloud=dataclasses.replace(picture.cloud, viewport=viewport))


_observe = jax.jit(observe, static_argnames="viewport")
