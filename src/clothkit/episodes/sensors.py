"""Sensors: from the true cloths of a world to what an agent observes of them."""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from clothkit.cloth.grid import flat
from clothkit.cloth.voxels import observe
from clothkit.errors import InputError
from clothkit.observation.picture import PictureConfig, take
from clothkit.planning.perception import Perception
from clothkit.planning.types import Meshes, Observation, States


class Sensed(NamedTuple):
    """An observation of true cloths, and how far it is off."""

    observation: Observation
    shift: Float[np.ndarray, "task 2"]
    """Vectors from the true centres to the observed ones [normalised]."""


Sensor = Callable[[Meshes, States | None], Sensed]
"""Observes true, centred meshes [task u v 3]. Also takes what the agent expects of them, None before its first plan."""


def exact_sensor(perception: Perception) -> Sensor:
    """A sensor that gives a perception exact observations: the meshes themselves, or voxels free of noise."""

    def sense(truth: Meshes, expected: States | None) -> Sensed:
        if perception.height is None:
            observation = Observation(meshes=truth)
        else:
            observation = Observation(voxels=np.asarray(_observe(truth, height=perception.height)))
        return Sensed(observation, np.zeros((len(truth), 2), np.float32))

    return sense


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
                missing = flat() if expected is None else expected[number]
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
