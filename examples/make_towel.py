"""Writes examples/towel.ply, a flat towel as a depth camera sees it.  ./run python examples/make_towel.py [FILE]

A towel of 0.5 x 0.3 m and 5 mm, turned by 20 degrees, 0.8 m straight below a camera; depth has noise of 1 mm.
Points are in metres, in the camera's frame.
"""

import sys

import numpy as np
import trimesh

from clothkit.cloth.topology import CLOTH_LENGTH, rectangle
from clothkit.observation.camera import CameraConfig, back_project, render

LONGER, SHORTER, THICKNESS = 0.5, 0.3, 0.005
ANGLE = 0.35
NOISE = 0.001
EVERY = 2
"""One point of so many is kept."""


def towel() -> np.ndarray:
    """Return the points that the camera sees of the towel, [points 3] in its frame."""
    topology = rectangle(LONGER / SHORTER)
    mesh = topology.flat().astype(float) * (LONGER / CLOTH_LENGTH)
    c, s = np.cos(ANGLE), np.sin(ANGLE)
    mesh[..., :2] = mesh[..., :2] @ np.array([[c, s], [-s, c]])
    mesh[..., 2] = THICKNESS  # what a camera sees is the upper side
    cloud = back_project(render(mesh, topology.triangles(), CameraConfig(height=0.8)))
    points = cloud.points[cloud.cloth]
    points[:, 2] += np.random.default_rng(0).normal(0, NOISE, len(points))
    return points[::EVERY].astype(np.float32)


if __name__ == "__main__":
    trimesh.PointCloud(towel()).export(sys.argv[1] if len(sys.argv) > 1 else "examples/towel.ply")
