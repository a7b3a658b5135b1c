"""Silhouettes (masks of the area that a cloth covers, seen from above), their centre and their overlap (4.2.1)."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from clothkit.cloth.topology import triangles

# cv2 takes sub-pixel positions as integers with this many fractional bits.
_SHIFT = 4


def silhouette(
    mesh: Float[np.ndarray, "u v 3"], *, resolution: int = 256, extent: float = 1.1
) -> Bool[np.ndarray, "x y"]:
    """Mask of the pixels of the square -extent..extent [normalised] that the cloth's triangles cover from above.

    Pixel (i, j) spans x in -extent + 2 extent / resolution * (i, i + 1), and y in the same way with j.
    """
    pixels = (mesh[..., :2].reshape(-1, 2) + extent) * (resolution / (2 * extent)) - 0.5
    # cv2 indexes images as (row, column) and points as (column, row); here the row is x.
    corners = np.rint(pixels[triangles(mesh.shape[:2])][..., ::-1] * 2**_SHIFT).astype(np.int32)
    image = np.zeros((resolution, resolution), np.uint8)
    for corner in corners:
        cv2.fillConvexPoly(image, corner, 1, lineType=cv2.LINE_8, shift=_SHIFT)
    return image.astype(bool)


def pixel_centres(resolution: int, extent: float) -> Float[np.ndarray, " resolution"]:
    """The coordinate of each pixel's centre along one axis [normalised]."""
    return (np.arange(resolution) + 0.5) * (2 * extent / resolution) - extent


def centre(mesh: Float[np.ndarray, "u v 3"], *, resolution: int = 256, extent: float = 1.1) -> Float[np.ndarray, "2"]:
    """Mean x, y of the silhouette's pixels [normalised].

    The raster is centred on the mesh's bounding box, so the mesh may lie anywhere.
    """
    middle = (mesh[..., :2].max((0, 1)) + mesh[..., :2].min((0, 1))) / 2
    moved = mesh - np.append(middle, 0).astype(mesh.dtype)
    covered = silhouette(moved, resolution=resolution, extent=extent)
    axis = pixel_centres(resolution, extent)
    x, y = np.nonzero(covered)
    return (middle + np.array([axis[x].mean(), axis[y].mean()])).astype(np.float32)


def centred(mesh: Float[np.ndarray, "u v 3"]) -> tuple[Float[np.ndarray, "u v 3"], Float[np.ndarray, "2"]]:
    """The mesh translated to have its centre at (0, 0), and its centre before that [normalised]."""
    middle = centre(mesh)
    return mesh - np.append(middle, 0).astype(mesh.dtype), middle


def iou(a: Bool[np.ndarray, "x y"], b: Bool[np.ndarray, "x y"]) -> float:
    """Intersection over union of two silhouettes (section 6.5); 1 when both are empty."""
    union = np.logical_or(a, b).sum()
    return float(np.logical_and(a, b).sum() / union) if union else 1.0
