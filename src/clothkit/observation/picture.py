"""Pictures of simulated cloths by a depth camera: rendered, made noisy, and observed as users' clouds are."""

import dataclasses
import zlib
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt
from jaxtyping import Float

from clothkit.cloth.topology import CLOTH_LENGTH, triangles
from clothkit.observation.camera import CameraConfig, DepthImage, back_project, render
from clothkit.observation.cloud import Observation, observe_cloud
from clothkit.observation.noise import NoiseConfig, noisy
from clothkit.observation.settings import CloudConfig
from clothkit.runtime.config import config
from clothkit.runtime.errors import InputError

_OFF = 1 << 16
"""Distance between the seeds of two pictures of one cloth."""


@config
class PictureConfig:
    """A camera, its noise, and how its clouds become voxels."""

    camera: CameraConfig = CameraConfig()
    noise: NoiseConfig | None = NoiseConfig()
    """None: no noise."""
    cloud: CloudConfig = CloudConfig()
    side: Annotated[float, Gt(0)] = 0.4
    """Side of the flat cloth, the longer one if it is no square [m]."""
    off: Annotated[float, Ge(0)] = 0.05
    """Largest distance of the cloth's centre from the point that the camera aims at, along x and along y [m]."""
    attempts: Annotated[int, Gt(0)] = 5
    """Largest number of pictures that are taken until one shows a cloth on a table."""
    seed: Annotated[int, Ge(0)] = 0


@dataclasses.dataclass(frozen=True)
class Picture:
    """A depth image of a cloth and the observation from it."""

    image: DepthImage
    observation: Observation
    shift: Float[np.ndarray, "2"]
    """From the cloth's true centre to the observed one [normalised]."""
    attempts: int
    """Number of pictures that were taken."""


def take(mesh: Float[np.ndarray, "u v 3"], settings: PictureConfig) -> Picture:
    """A picture of a normalised, centred mesh at a random place in front of the camera. Same mesh, same picture.

    The table's plane is not given but found in the cloud. Raises InputError when none of the attempts shows a cloth on
    a table.
    """
    base = zlib.crc32(np.ascontiguousarray(mesh, np.float32).tobytes())
    scale = settings.side / CLOTH_LENGTH
    place = np.random.default_rng([settings.seed, base]).uniform(-settings.off, settings.off, 2)
    clean = render(mesh.astype(float) * scale + [*place, 0.0], triangles(mesh.shape[:2]), settings.camera)
    for attempt in range(1, settings.attempts + 1):
        seed = base + _OFF * (settings.seed + attempt)
        image = clean if settings.noise is None else noisy(clean, settings.noise, seed=seed)
        cloud = back_project(image)
        try:
            found = observe_cloud(cloud, cloth_side=settings.side, settings=settings.cloud, name="picture")
        except InputError:
            if settings.noise is None or attempt == settings.attempts:
                raise
            continue
        camera = settings.camera
        centre = found.pose.normalised_to_camera(np.zeros(3)) @ camera.axes() + camera.position()
        return Picture(image, found, ((centre[:2] - place) / scale).astype(np.float32), attempt)
    raise AssertionError("unreachable: the last attempt returns or raises")
