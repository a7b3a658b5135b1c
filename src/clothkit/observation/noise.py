"""Noise of depth cameras: along the ray and across it, quantised depth, pixels without a measurement.

Its size is what Nguyen, Izadi and Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction and tracking"
(3DIMPVT 2012), measured with a first-generation Kinect. Noise is independent from pixel to pixel.
"""

import dataclasses
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le
from jaxtyping import Bool, Float
from scipy import ndimage

from clothkit.observation.camera import DepthImage
from clothkit.runtime.config import config

NotNegative = Annotated[float, Ge(0)]
Share = Annotated[float, Ge(0), Le(1)]


@config
class NoiseConfig:
    """Sizes of a depth camera's errors."""

    axial: NotNegative = 0.0005
    """Standard deviation of depth near the camera [m]."""
    axial_growth: NotNegative = 0.0015
    """Growth of the standard deviation: this times depth squared is added to it [1/m]."""
    lateral: NotNegative = 0.5
    """Standard deviation of the position at which a pixel measures [pixels], in each direction."""
    step: NotNegative = 0.0028
    """Quantisation step of 1 / depth, as of structured light [1/m]; 0: none. Steps of depth are this times depth²."""
    grazing: Annotated[float, Gt(0)] = 1.3
    """Angle between a ray and the surface's normal from which nothing is measured [rad]."""
    edge: Annotated[float, Gt(0)] = 0.006
    """Difference of depth between neighbouring pixels above which they are an edge [m]."""
    edge_dropout: Share = 0.5
    """Probability that a pixel at an edge is not measured."""
    dropout: Share = 0.01
    """Probability that any pixel is not measured."""
    holes: Annotated[int, Ge(0)] = 10
    """Number of round spots in the image that are not measured."""
    hole_radius: NotNegative = 3.0
    """Radius of these spots [pixels]."""

    def times(self, factor: float) -> "NoiseConfig":
        """The settings with noise, dropout probabilities and the number of holes multiplied by `factor`.

        The thresholds `grazing` and `edge` and the radius of holes are kept.
        """
        return dataclasses.replace(
            self,
            axial=self.axial * factor,
            axial_growth=self.axial_growth * factor,
            lateral=self.lateral * factor,
            step=self.step * factor,
            edge_dropout=min(1.0, self.edge_dropout * factor),
            dropout=min(1.0, self.dropout * factor),
            holes=round(self.holes * factor),
        )


def noisy(image: DepthImage, settings: NoiseConfig, *, seed: int) -> DepthImage:
    """The depth image with a camera's noise. Same seed, same image.

    The mask of the cloth is jittered in the same way, so it stays correct. Pixels that are not measured leave it.
    """
    random = np.random.default_rng(seed)
    rows, columns = image.depth.shape
    # Everything is drawn for every pixel, whatever the settings are, so that one setting doesn't change other draws.
    jitter = random.standard_normal((2, rows, columns)) * settings.lateral
    along = random.standard_normal((rows, columns))
    lost = random.random((rows, columns))
    spots = random.uniform(0, 1, (settings.holes, 2)) * [rows, columns]

    row, column = np.indices((rows, columns))
    row = np.clip(np.rint(row + jitter[0]), 0, rows - 1).astype(int)
    column = np.clip(np.rint(column + jitter[1]), 0, columns - 1).astype(int)
    depth, cloth = image.depth[row, column], image.cloth[row, column]
    depth = depth + along * (settings.axial + settings.axial_growth * depth**2) * (depth > 0)
    measured = depth > 0
    if settings.step:
        inverse = np.rint(1 / np.where(measured, depth, 1) / settings.step) * settings.step
        depth = np.where(inverse > 0, 1 / np.where(inverse > 0, inverse, 1), 0)
    measured &= ~(incidence(image) > settings.grazing)[row, column]
    measured &= ~(_edges(image.depth, settings.edge) & (lost < settings.edge_dropout))
    measured &= ~(lost > 1 - settings.dropout)
    for spot in spots:
        measured &= (row - spot[0]) ** 2 + (column - spot[1]) ** 2 > settings.hole_radius**2
    return DepthImage(np.where(measured, depth, 0), cloth & measured, image.camera)


def incidence(image: DepthImage) -> Float[np.ndarray, "rows columns"]:
    """The angle between each pixel's ray and the surface normal [rad], which differences between neighbours give."""
    points = image.points()
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    length = np.linalg.norm(normal, axis=-1) * np.linalg.norm(points, axis=-1)
    cosine = np.abs((normal * points).sum(-1)) / np.where(length > 0, length, 1)
    return np.where(length > 0, np.arccos(np.clip(cosine, 0, 1)), 0)


def _edges(depth: np.ndarray, threshold: float) -> Bool[np.ndarray, "rows columns"]:
    """The pixels whose depth differs from a neighbour's by more than the threshold."""
    cross = ndimage.generate_binary_structure(2, 1)
    return ndimage.maximum_filter(depth, footprint=cross) - ndimage.minimum_filter(depth, footprint=cross) > threshold
