"""A simulated depth camera above a cloth on a table: depth images, and point clouds from them.

The camera's frame is that of OpenCV: x to the right, y down, z forward. Depth is z, not the length of the ray. The
table is the plane z = 0 of the table's frame.
"""

import dataclasses
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Lt
from jaxtyping import Bool, Float, Int

from clothkit.observation.plane import Plane
from clothkit.observation.states import PointCloud
from clothkit.observation.zbuffer import topmost
from clothkit.runtime.config import config

_ROUNDING = 1e-9
_NEAREST = 0.01  # m in front of the camera; triangles with a nearer vertex are left out


@config
class CameraConfig:
    """A pinhole camera above the table. Default: a Kinect's field of view, 57 by 44 degrees, at half its resolution."""

    columns: Annotated[int, Gt(0)] = 320
    rows: Annotated[int, Gt(0)] = 240
    focal: Annotated[float, Gt(0)] = 295.0
    """Focal length [pixels]."""
    principal: tuple[float, float] | None = None
    """Column and row of the principal point [pixels]; (0, 0) is the image's upper left corner. None: the middle."""
    height: Annotated[float, Gt(0)] = 0.8
    """Height of the camera above the table [m]."""
    tilt: Annotated[float, Ge(0), Lt(1.5)] = 0.0
    """Angle between the viewing direction and straight down [rad]."""
    azimuth: float = 0.0
    """Rotation of the camera about the table's z axis [rad]; at 0, the image's right is the table's x."""
    aim: tuple[float, float] = (0.0, 0.0)
    """The point of the table that the principal point shows, xy [m]."""
    table_side: Annotated[float, Gt(0)] = 1.5
    """Side of the square table around `aim` [m]; pixels that look past it measure nothing."""

    def middle(self) -> tuple[float, float]:
        """Column and row of the principal point [pixels]; pixel (i, j) is centred at row i + 0.5, column j + 0.5."""
        return self.principal or (self.columns / 2, self.rows / 2)

    def axes(self) -> Float[np.ndarray, "3 3"]:
        """The camera's axes x, y, z as rows, in the table's frame."""
        sine, cosine = np.sin(self.tilt), np.cos(self.tilt)
        level = np.array([[1.0, 0.0, 0.0], [0.0, -cosine, -sine], [0.0, sine, -cosine]])
        sine, cosine = np.sin(self.azimuth), np.cos(self.azimuth)
        return level @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])

    def position(self) -> Float[np.ndarray, "3"]:
        """The camera's position in the table's frame [m]."""
        forward = self.axes()[2]
        return np.append(self.aim, 0.0) - forward * (self.height / -forward[2])

    def table(self) -> Plane:
        """The table's plane in the camera's frame, as calibration would give it."""
        return Plane(self.axes()[:, 2].copy(), -self.height)

    def rays(self) -> Float[np.ndarray, "rows columns 3"]:
        """The point at depth 1 on the ray through each pixel's centre, in the camera's frame [m]."""
        column, row = self.middle()
        x = (np.arange(self.columns) + 0.5 - column) / self.focal
        y = (np.arange(self.rows) + 0.5 - row) / self.focal
        return np.stack([*np.meshgrid(x, y), np.ones((self.rows, self.columns))], axis=-1)


@dataclasses.dataclass(frozen=True)
class DepthImage:
    """A depth image and the mask of the cloth in it."""

    depth: Float[np.ndarray, "rows columns"]
    """Metres along the camera's z, 0 where nothing was measured."""
    cloth: Bool[np.ndarray, "rows columns"]
    """The pixels that show the cloth, as a segmentation by colour would give them."""
    camera: CameraConfig

    def points(self) -> Float[np.ndarray, "rows columns 3"]:
        """The point that each pixel shows, in the camera's frame [m]; (0, 0, 0) where nothing was measured."""
        return self.camera.rays() * self.depth[..., None]


def render(
    vertices: Float[np.ndarray, "*vertices 3"], triangles: Int[np.ndarray, "triangles 3"], camera: CameraConfig
) -> DepthImage:
    """The depth image of a cloth on the table, without noise; the cloth hides what lies behind it.

    Vertices are in metres in the table's frame. Triangles have no thickness, so the visible surface passes through the
    vertices. Triangles that reach behind the camera are left out.
    """
    inverse, owner = np.zeros((camera.rows, camera.columns)), np.full((camera.rows, camera.columns), -1)
    seen = (vertices.reshape(-1, 3).astype(float) - camera.position()) @ camera.axes().T
    corners = seen[triangles]
    corners = corners[(corners[..., 2] > _NEAREST).all(1)]
    if len(corners):
        pixels = corners[..., :2] / corners[..., 2:] * camera.focal + np.array(camera.middle())
        inverse, owner = topmost(pixels, 1 / corners[..., 2], inverse.shape)
    table = _inverse_depth_of_table(camera)
    # Cloth in the table's plane is visible, even if rounding puts it slightly below.
    cloth = (owner >= 0) & (inverse >= table * (1 - _ROUNDING))
    nearest = np.where(cloth, inverse, table)
    depth = np.where(nearest > 0, 1 / np.where(nearest > 0, nearest, 1), 0)
    return DepthImage(depth, cloth, camera)


def _inverse_depth_of_table(camera: CameraConfig) -> np.ndarray:
    """1 / depth at which each pixel sees the table, 0 beyond its edge."""
    rays = camera.rays() @ camera.axes()
    inverse = np.maximum(-rays[..., 2] / camera.height, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        xy = camera.position()[:2] + rays[..., :2] / inverse[..., None]
    on_it = (np.abs(xy - camera.aim) <= camera.table_side / 2).all(-1) & (inverse > 0)
    return np.where(on_it, inverse, 0)


def back_project(image: DepthImage) -> PointCloud:
    """The depth image as a point cloud in the camera's frame [m], with the mask of the cloth but without the table."""
    measured = image.depth > 0
    return PointCloud(image.points()[measured], cloth=image.cloth[measured], viewpoint=np.zeros(3))
