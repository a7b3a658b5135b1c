"""Sensors: from the true cloths of a world to what an agent observes of them."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from clothkit.cloth.voxels import observe
from clothkit.planning.batches import BATCH, in_batches
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
        if perception.viewport is None:
            observation = Observation(meshes=truth)
        else:
            observation = Observation(voxels=in_batches(partial(_observe, viewport=perception.viewport), BATCH, truth))
        return Sensed(observation, np.zeros((len(truth), 2), np.float32))

    return sense


_observe = jax.jit(observe, static_argnames="viewport")
