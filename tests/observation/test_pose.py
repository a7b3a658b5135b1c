"""Frames there and back, planes under rigid motions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.observation.camera import CameraConfig
from clothkit.observation.plane import LEVEL, Plane, PlaneConfig, find, plane_of
from clothkit.observation.pose import Pose
from tests.observation.scenes import motion

SEED = st.integers(0, 10_000)


def table_points(random: np.random.Generator, count: int = 800, noise: float = 0.001) -> np.ndarray:
    return np.column_stack([random.uniform(-0.5, 0.5, (count, 2)), random.normal(0, noise, count)])


@given(SEED, st.floats(0.05, 2))
def test_every_frame_comes_back(seed: int, scale: float) -> None:
    rotation, origin = motion(seed)
    random = np.random.default_rng(seed)
    pose = Pose(rotation, origin, random.uniform(-1, 1, 2), scale)
    points = random.uniform(-1, 1, (5, 7, 3))
    np.testing.assert_allclose(pose.table_to_normalised(pose.normalised_to_table(points)), points, atol=1e-9)
    np.testing.assert_allclose(pose.camera_to_table(pose.table_to_camera(points)), points, atol=1e-9)
    np.testing.assert_allclose(pose.camera_to_normalised(pose.normalised_to_camera(points)), points, atol=1e-9)
    # A rigid motion and a scale: distances keep their ratio.
    there = pose.normalised_to_camera(points)
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(there, axis=1), axis=-1), scale * np.linalg.norm(np.diff(points, axis=1), axis=-1)
    )
    moved = pose.moved(np.array([0.1, -0.2]))
    shift = moved.normalised_to_table(points) - pose.normalised_to_table(points)
    np.testing.assert_allclose(shift, np.broadcast_to([0.1 * scale, -0.2 * scale, 0], shift.shape), atol=1e-12)


def test_frames_by_hand() -> None:
    # A camera 0.8 m above the table, x to the right, y down the image: its rows of the table's axes.
    pose = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.8]), np.array([0.1, 0.2]), 0.5)
    np.testing.assert_allclose(pose.normalised_to_table(np.array([1.0, 0.0, 0.1])), [0.6, 0.2, 0.05])
    np.testing.assert_allclose(pose.normalised_to_camera(np.array([1.0, 0.0, 0.1])), [0.6, -0.2, 0.75])


@given(SEED)
def test_the_table_is_found_wherever_the_camera_is(seed: int) -> None:
    random = np.random.default_rng(seed)
    rotation, origin = motion(seed)
    clutter = random.uniform([-0.5, -0.5, 0.05], [0.5, 0.5, 0.5], (300, 3))
    scene = np.concatenate([table_points(random), clutter])
    seen = scene @ rotation.T + origin
    plane = find(seen, PlaneConfig())
    # Either side may be up.
    assert np.degrees(np.arccos(np.clip(abs(plane.normal @ rotation[:, 2]), -1, 1))) < 0.3
    assert np.abs(plane.heights(origin)) < 0.001
    axes, place = plane.frame()
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(axes) == pytest.approx(1)
    assert np.abs(plane.heights(place)) < 1e-9
    np.testing.assert_allclose((seen - place) @ axes.T @ [0, 0, 1], plane.heights(seen), atol=1e-9)
    again = find(seen, PlaneConfig())
    np.testing.assert_array_equal(again.normal, plane.normal)


def test_a_level_table_keeps_its_frame_and_a_camera_sees_its_x_to_the_right() -> None:
    axes, origin = LEVEL.frame()
    np.testing.assert_array_equal(axes, np.eye(3))
    np.testing.assert_array_equal(origin, np.zeros(3))
    axes, origin = CameraConfig(tilt=0.4).table().frame()
    np.testing.assert_allclose(axes[0], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(axes, CameraConfig(tilt=0.4).axes().T, atol=1e-12)
    assert np.linalg.norm(origin) == pytest.approx(0.8)


def test_planes_from_coefficients_of_any_length() -> None:
    plane = plane_of((0.0, 0.0, 2.0, 1.0))
    np.testing.assert_allclose(plane.normal, [0, 0, 1])
    assert plane.offset == pytest.approx(0.5)
    upright = Plane(np.array([1.0, 0.0, 0.0]), 0.2).frame()[0]
    np.testing.assert_allclose(upright, [[0, 1, 0], [0, 0, 1], [1, 0, 0]], atol=1e-12)
