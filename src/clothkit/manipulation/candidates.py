"""Detection of candidate grasp points: convex corners of a cloth's silhouette (section 4.3)."""

from typing import Annotated

import cv2
import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from jaxtyping import Bool, Float
from scipy import ndimage

from clothkit.cloth.silhouette import pixel_centres, silhouette
from clothkit.runtime.config import config

EDGE_BLUR = 0.025
"""Standard deviation of the blur that smooths the steps in a silhouette of voxels [normalised]."""


@config
class CandidateConfig:
    """Settings of the corner detector. Lengths are in normalised units."""

    resolution: Annotated[int, Ge(256), Le(2048)] = 256
    extent: Annotated[float, Gt(1.0), Le(4.0)] = 1.1
    most: Annotated[int, Ge(1), Le(100)] = 12
    quality: Annotated[float, Gt(0), Lt(1)] = 0.08
    """Least corner response as a share of the strongest corner's."""
    spacing: Annotated[float, Gt(0), Le(1)] = 0.1
    """Least distance between two corners."""
    block: Annotated[float, Gt(0), Le(0.5)] = 0.07
    """Side of the window over which the gradients are summed."""
    radius: Annotated[float, Gt(0), Le(1)] = 0.14
    """Radius of the disc that decides whether a corner is convex."""
    convex: Annotated[float, Gt(0), Lt(1)] = 0.45
    """A corner is convex if less than this share of its disc is cloth."""


def candidates(
    mesh: Float[np.ndarray, "u v 3"], settings: CandidateConfig | None = None
) -> Float[np.ndarray, "candidates 2"]:
    """Candidate grasp points of a mesh, xy [normalised]: convex Shi-Tomasi corners of the silhouette, strongest first.

    Each corner is replaced by the outermost vertex near it, because the detector returns a pixel inside the corner, a
    fraction of the grid spacing away from the cloth's corner itself.
    """
    settings = settings or CandidateConfig()
    middle = (mesh[..., :2].max((0, 1)) + mesh[..., :2].min((0, 1))) / 2
    moved = mesh - np.append(middle, 0).astype(mesh.dtype)
    image = silhouette(moved, resolution=settings.resolution, extent=settings.extent)
    corners = convex_corners(image, settings)
    vertices = moved[..., :2].reshape(-1, 2)
    return (_snap_outwards(corners, vertices, image, settings) + middle).astype(np.float32)


def voxel_candidates(
    voxels: Bool[np.ndarray, "x y z"], settings: CandidateConfig | None = None
) -> Float[np.ndarray, "candidates 2"]:
    """Candidate grasp points of voxels over -1..1, xy [normalised]: convex corners of their projection from above.

    If there is no corner, the mean position of the occupied columns is the only candidate.
    """
    settings = settings or CandidateConfig()
    covered = np.asarray(voxels).any(axis=-1).astype(np.float32)
    side = covered.shape[0]
    axis = pixel_centres(settings.resolution, settings.extent)
    cells = (axis + 1) * (side / 2) - 0.5
    smooth = ndimage.map_coordinates(covered, np.meshgrid(cells, cells, indexing="ij"), order=1, mode="constant")
    blur = EDGE_BLUR * settings.resolution / (2 * settings.extent)
    corners = convex_corners(cv2.GaussianBlur(smooth, (0, 0), blur) > 0.5, settings)
    if not len(corners):
        occupied = np.argwhere(covered > 0) if covered.any() else np.full((1, 2), side / 2 - 0.5)
        corners = ((occupied + 0.5) * (2 / side) - 1).mean(0, keepdims=True)
    return np.clip(corners, -1, 1).astype(np.float32)


def convex_corners(image: Bool[np.ndarray, "x y"], settings: CandidateConfig) -> Float[np.ndarray, "corners 2"]:
    """Convex Shi-Tomasi corners of a silhouette, xy [normalised], strongest first."""
    pixel = 2 * settings.extent / settings.resolution
    block = max(3, round(settings.block / pixel) | 1)
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), block / 5)
    found = cv2.goodFeaturesToTrack(smooth, settings.most, settings.quality, settings.spacing / pixel, blockSize=block)
    axis = pixel_centres(settings.resolution, settings.extent)
    if found is None:
        return np.zeros((0, 2))
    # cv2 returns points as (column, row), which is (y, x) here.
    cells = np.rint(found.reshape(-1, 2)[:, ::-1]).astype(int)
    corners = np.stack([axis[cells[:, 0]], axis[cells[:, 1]]], axis=-1)
    shares = [_cloth_share(image, axis, corner, settings.radius) for corner in corners]
    return corners[np.array(shares) < settings.convex]


def _cloth_share(image: np.ndarray, axis: np.ndarray, corner: np.ndarray, radius: float) -> float:
    disc = (axis[:, None] - corner[0]) ** 2 + (axis[None, :] - corner[1]) ** 2 <= radius**2
    return float(image[disc].mean())


def _snap_outwards(
    corners: np.ndarray, vertices: np.ndarray, image: np.ndarray, settings: CandidateConfig
) -> np.ndarray:
    axis = pixel_centres(settings.resolution, settings.extent)
    reach = 0.4 * settings.radius
    snapped = []
    for corner in corners:
        disc = (axis[:, None] - corner[0]) ** 2 + (axis[None, :] - corner[1]) ** 2 <= settings.radius**2
        i, j = np.nonzero(image & disc)
        outwards = corner - np.array([axis[i].mean(), axis[j].mean()])
        near = vertices[np.linalg.norm(vertices - corner, axis=-1) <= reach]
        snapped.append(near[np.argmax(near @ outwards)] if len(near) else corner)
    return np.array(snapped).reshape(-1, 2)
