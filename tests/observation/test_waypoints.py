"""Arcs by hand, in metres and seconds; turns that keep the cloth as it is."""

import numpy as np
import pytest

from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import SQUARE
from clothkit.observation.pose import Pose
from clothkit.observation.waypoints import (
    MotionConfig,
    hand_paths,
    symmetries,
)
from tests.observation.scenes import SCALE, folded
from tests.observation.scenes import turned as turned_mesh

POSE = Pose(np.eye(3), np.zeros(3), np.array([0.5, 0.1]), SCALE)
HALF = np.array([1.0, -1.0, 1.0, 1.0, -1.4, 0.0], np.float32)


def test_a_half_fold_in_metres_and_seconds() -> None:
    paths = hand_paths(HALF, SQUARE.flat(), POSE, MotionConfig(waypoints=41))
    assert paths.points.shape == (2, 41, 3)
    # From the corners x = +0.2 m to the corners x = -0.2 m, which are 0.2 normalised higher.
    np.testing.assert_allclose(paths.points[0, 0], [0.7, -0.1, 0.0], atol=1e-6)
    np.testing.assert_allclose(paths.points[1, 0], [0.7, 0.3, 0.0], atol=1e-6)
    np.testing.assert_allclose(paths.points[:, -1], [[0.3, -0.1, 0.2 * SCALE], [0.3, 0.3, 0.2 * SCALE]], atol=1e-6)
    # Every waypoint is on the circle through both ends whose centre is at the table's height.
    radius = (0.4**2 + (0.2 * SCALE) ** 2) / (2 * 0.4)
    middle = np.array([0.7 - radius, -0.1, 0.0])
    np.testing.assert_allclose(np.linalg.norm(paths.points[0] - middle, axis=-1), radius, atol=1e-6)
    # At the mean speed, slower at both ends than between.
    length = np.linalg.norm(np.diff(paths.points[0], axis=0), axis=-1)
    assert paths.times[-1] == pytest.approx(length.sum() / 0.42, rel=1e-3)
    speed = length / np.diff(paths.times)
    assert speed[0] < 0.2 * speed.max()
    assert speed[-1] < 0.2 * speed.max()
    assert paths.times[0] == 0


def test_one_hand_none_and_short_moves() -> None:
    single = np.array([1, 1, 1, 1, -0.6, 0.0], np.float32)
    paths = hand_paths(single, SQUARE.flat(), POSE)
    assert paths.points.shape == (1, 21, 3)
    assert paths.points[0, -1, 2] == pytest.approx(0.2 * SCALE, abs=1e-6)
    assert hand_paths(single, SQUARE.flat(), POSE, MotionConfig(hand_speed=9.0)).times[-1] == pytest.approx(0.4)
    null = np.array([1, 1, 1, 1, -0.3, 0.3], np.float32)
    assert hand_paths(null, SQUARE.flat(), POSE).points.shape == (0, 21, 3)
    lifted = hand_paths(single, SQUARE.flat() + np.float32([0, 0, 0.1]), POSE)
    np.testing.assert_allclose(
        lifted.points - paths.points, np.broadcast_to([0, 0, 0.1 * SCALE], (1, 21, 3)), atol=1e-6
    )


@pytest.mark.parametrize("angle", [0.0, 0.3, -1.0])
def test_a_flat_cloth_has_eight_symmetries_however_it_lies(angle: float) -> None:
    mesh = turned_mesh(SQUARE.flat(), angle)
    found = symmetries(mesh)
    assert len(found) == 8
    np.testing.assert_array_equal(found[0], np.eye(2))
    assert sum(np.linalg.det(matrix) > 0 for matrix in found) == 4
    corners = mesh[[0, 0, -1, -1], [0, -1, 0, -1], :2]
    for matrix in found:
        moved = corners @ matrix.T
        assert np.linalg.norm(moved[:, None] - corners, axis=-1).min(1).max() < 1e-4


def test_a_folded_cloth_has_its_mirror_alone() -> None:
    found = symmetries(folded(angle=0.3))
    assert len(found) == 2
    assert np.linalg.det(found[1]) == pytest.approx(-1, abs=1e-5)


def test_crumpled_cloth_is_not_turned() -> None:
    bent = SQUARE.flat().copy()
    bent[20:, 12:, :2] -= [0.4, 0.1]
    assert len(symmetries(centred(bent)[0])) == 1


def test_a_rectangle_that_is_nearly_a_square_has_no_quarter_turns() -> None:
    mesh = SQUARE.flat() * np.float32([1, 0.96, 1])
    assert len(symmetries(mesh)) == 8
    cloth = np.array([1.4, 1.4 * 0.96, 0.007], np.float32)
    found = symmetries(mesh, cloth=cloth)
    assert len(found) == 4
    for matrix in found:
        np.testing.assert_allclose(np.abs(matrix), np.eye(2), atol=1e-6)
