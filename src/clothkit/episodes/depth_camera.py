"""A sensor that is a simulated depth camera above the table (section 6.5)."""

import dataclasses

import jax
import numpy as np

from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import observe
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
        for number, mesh in enumerate(truth):
            try:
                picture = take(mesh, self.picture)
            except InputError:
                missing = SQUARE.flat() if expected is None else expected[number]
                voxels.append(np.asarray(_observe(missing, height=self.picture.cloud.height)))
                continue
            voxels.append(picture.observation.voxels)
            shift[number] = picture.shift
        return Sensed(Observation(voxels=np.stack(voxels)), shift)


def depth_camera(picture: PictureConfig, perception: Perception) -> DepthCamera:
    """A depth camera whose voxel grid has the height that a perception takes."""
    assert perception.height is not None, "a perception that takes voxels"
    return DepthCamera(with_height(picture, perception.height))


def with_height(picture: PictureConfig, height: float) -> PictureConfig:
    """The camera's settings with another height of the voxel grid [normalised]."""
    return dataclasses.replace(picture, cloud=dataclasses.replace(picture.cloud, height=height))


_observe = jax.jit(observe, static_argnames="height")
