import numpy as np

from clothkit.cloth import voxels
from clothkit.cloth.topology import SQUARE
from clothkit.manipulation.candidates import candidates, voxel_candidates


def _nearest(points: np.ndarray, target: tuple[float, float]) -> float:
    return float(np.linalg.norm(points - np.array(target), axis=-1).min())


def _turned(mesh: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.concatenate([mesh[..., :2] @ np.array([[c, s], [-s, c]]), mesh[..., 2:]], -1).astype(np.float32)


def test_a_flat_cloth_is_graspable_at_its_corners_wherever_it_lies() -> None:
    for angle in (0.0, 0.3, 0.785):
        mesh = _turned(SQUARE.flat(), angle) + np.float32([0.4, -0.3, 0])
        points = candidates(mesh)
        assert len(points) == 4
        for i in (0, 31):
            for j in (0, 31):
                assert _nearest(points, tuple(mesh[i, j, :2])) < 1e-5


def test_concave_corners_are_left_out() -> None:
    # An L: the quarter x > 0, y > 0 is folded onto the rest.
    mesh = SQUARE.flat()
    mesh[16:, 16:, 0] = mesh[15::-1, 16:, 0]
    points = candidates(mesh)
    assert _nearest(points, (0, 0)) > 0.1
    for corner in [(-0.7, -0.7), (0.7, -0.7), (-0.7, 0.7), (0.7, 0), (0, 0.7)]:
        assert _nearest(points, corner) < 0.08


def test_a_corner_is_moved_to_a_vertex_near_it_and_to_no_other_however_far_out() -> None:
    """An L with a long arm: along the diagonal the end of that is farther out than the corner of the short one."""
    mesh = SQUARE.flat()
    mesh[16:, 10:, 0] = mesh[15::-1, 10:, 0]
    points = candidates(mesh)
    for corner in [(-0.7, -0.7), (0.7, -0.7), (-0.7, 0.7), tuple(mesh[31, 9, :2]), (0, 0.7)]:
        assert _nearest(points, corner) < 0.05


def test_a_diagonal_fold_has_three_corners() -> None:
    mesh = SQUARE.flat()
    x, y = mesh[..., 0].copy(), mesh[..., 1].copy()
    over = x + y > 0
    mesh[..., 0] = np.where(over, -y, x)
    mesh[..., 1] = np.where(over, -x, y)
    points = candidates(mesh)
    assert len(points) == 3
    for corner in [(-0.7, -0.7), (0.7, -0.7), (-0.7, 0.7)]:
        assert _nearest(points, corner) < 0.05


def test_candidates_of_voxels_are_near_those_of_the_mesh() -> None:
    found = voxel_candidates(np.asarray(voxels.observe(SQUARE.flat())))
    wanted = candidates(SQUARE.flat())
    assert len(found) == len(wanted) == 4
    distance = np.linalg.norm(found[:, None] - wanted, axis=-1)
    # Half a voxel is 0.03.
    assert distance.min(0).max() < 0.06
    assert sorted(distance.argmin(0).tolist()) == [0, 1, 2, 3]


def test_voxels_without_a_corner_are_grasped_in_their_middle() -> None:
    grid = np.zeros(voxels.RESOLUTION, bool)
    grid[20, 9, 3] = True
    np.testing.assert_allclose(voxel_candidates(grid), [[20.5 / 16 - 1, 9.5 / 16 - 1]], atol=1e-6)
    grid[24, 13, 5] = True
    np.testing.assert_allclose(voxel_candidates(grid), [[22.5 / 16 - 1, 11.5 / 16 - 1]], atol=1e-6)
    np.testing.assert_allclose(voxel_candidates(np.zeros_like(grid)), [[0, 0]], atol=1e-6)
