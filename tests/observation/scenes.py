"""Cloths that tests look at, and clouds of them in other frames."""

import numpy as np

from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE
from clothkit.observation.camera import CameraConfig, DepthImage, render

CLOTH = 0.4
SCALE = CLOTH / CLOTH_LENGTH
THICKNESS = 0.007  # normalised
SMALL = CameraConfig(columns=160, rows=120, focal=147.5)


def folded(*, along: float = 0.3, angle: float = 0.0) -> np.ndarray:
    """A cloth of which a strip lies on the rest: what is beyond x = `along` is wound over a half circle. Centred."""
    x = np.linspace(-CLOTH_LENGTH / 2, CLOTH_LENGTH / 2, SQUARE.shape[0])
    radius = 1.5 * THICKNESS
    past = x - along
    bent = np.clip(past / radius, 0, np.pi)
    rest = np.maximum(past - np.pi * radius, 0)
    placed = np.where(past < 0, x, along + radius * np.sin(bent) - rest)
    height = THICKNESS / 2 + radius * (1 - np.cos(bent)) * (past > 0)
    mesh = SQUARE.flat()
    mesh[..., 0], mesh[..., 2] = placed[:, None], height[:, None]
    return centred(turned(mesh, angle))[0]


def cornered(side: int = SQUARE.shape[0]) -> np.ndarray:
    """A cloth in metres, `side` vertices a side, of which a corner is folded over an oblique line.

    No mirror image of it looks the same. The flat cloth's middle is at (0.1, -0.05).
    """
    axis = (np.arange(side) / (side - 1) - 0.5) * CLOTH
    mesh = np.stack([*np.meshgrid(axis, axis, indexing="ij"), np.full((side, side), 0.001)], axis=-1)
    normal = np.array([0.9, 0.436]) / np.linalg.norm([0.9, 0.436])
    past = np.maximum(mesh[..., :2] @ normal - 0.1, 0)
    mesh[..., :2] -= 2 * past[..., None] * normal
    mesh[..., 2] += 0.005 * (past > 0)
    return mesh + np.array([0.1, -0.05, 0])


def turned(mesh: np.ndarray, angle: float) -> np.ndarray:
    """The mesh turned about z."""
    c, s = np.cos(angle), np.sin(angle)
    return (mesh @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])).astype(np.float32)


def image_of(mesh: np.ndarray, camera: CameraConfig, *, at: tuple[float, float] = (0.0, 0.0)) -> DepthImage:
    """What the camera sees of a normalised mesh whose centre lies at `at` [m] on the table."""
    metres = mesh.astype(float) * SCALE + [*at, 0.0]
    return render(metres, SQUARE.triangles(), camera)


def motion(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A random rigid motion: rotation and shift."""
    random = np.random.default_rng(seed)
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q)), random.uniform(-2, 2, 3)
