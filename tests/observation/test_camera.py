"""Depth against closed forms, the depth buffer against brute force, noise against what was asked for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.topology import SQUARE
from clothkit.observation.camera import CameraConfig, back_project, render
from clothkit.observation.noise import NoiseConfig, incidence, noisy
from clothkit.observation.zbuffer import topmost
from tests.observation.scenes import SCALE, SMALL, folded, image_of

NOTHING = np.zeros((0, 3)), np.zeros((0, 3), int)
SILENT = NoiseConfig(
    axial=0, axial_growth=0, lateral=0, step=0, grazing=1.57, edge_dropout=0, dropout=0, holes=0, hole_radius=0
)


def brute_force(corners: np.ndarray, values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    image = np.full(shape, -np.inf)
    for corner, value in zip(corners, values, strict=True):
        system = np.vstack([corner.T, np.ones(3)])
        for i, j in np.ndindex(shape):
            weights = np.linalg.solve(system, [j + 0.5, i + 0.5, 1])
            if (weights >= 0).all():
                image[i, j] = max(image[i, j], weights @ value)
    return image


def test_the_depth_buffer_is_the_brute_force_one(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(4)
    corners, values = random.uniform(-6, 18, (25, 3, 2)), random.uniform(0, 1, (25, 3))
    expected = brute_force(corners, values, (9, 12))
    image, owner = topmost(corners, values, (9, 12))
    np.testing.assert_allclose(image, expected, atol=1e-9)
    np.testing.assert_array_equal(owner >= 0, np.isfinite(expected))
    monkeypatch.setattr("clothkit.observation.zbuffer._PAIRS_TOGETHER", 50)
    np.testing.assert_allclose(topmost(corners, values, (9, 12))[0], expected, atol=1e-9)


def test_degenerate_triangles_and_none_at_all_show_nothing() -> None:
    line = np.array([[[1.0, 1.0], [3.0, 3.0], [5.0, 5.0]]])
    assert not np.isfinite(topmost(line, np.ones((1, 3)), (6, 6))[0]).any()
    assert (topmost(line[:0], np.ones((0, 3)), (6, 6))[1] == -1).all()


@given(st.floats(0, 1), st.floats(-3, 3), st.floats(0.4, 1.5))
def test_the_bare_table_is_where_rays_meet_it(tilt: float, azimuth: float, height: float) -> None:
    camera = CameraConfig(columns=16, rows=12, focal=15, tilt=tilt, azimuth=azimuth, height=height, table_side=100)
    image = render(*NOTHING, camera)
    # In the camera's frame the table's normal is (0, -sin, -cos): a ray (x, y, 1) meets it at height / (y sin + cos).
    y = (np.arange(12) + 0.5 - 6) / 15
    down = y * np.sin(tilt) + np.cos(tilt)
    expected = np.where(down > 1e-6, height / np.where(down > 1e-6, down, 1), 0)
    seen = (expected < 20) & (expected > 0)
    np.testing.assert_allclose(image.depth[seen], np.repeat(expected[seen, None], 16, axis=1), rtol=1e-9)
    cloud = back_project(image)
    np.testing.assert_allclose(camera.table().heights(cloud.points), 0, atol=1e-6)
    assert not image.cloth.any()


@given(st.floats(0, 0.6), st.floats(-3, 3), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_a_slanted_plane_has_the_depth_of_the_closed_form(tilt: float, azimuth: float, a: float, b: float) -> None:
    camera = CameraConfig(columns=24, rows=18, focal=22, tilt=tilt, azimuth=azimuth)
    corners = np.array([[-0.8, -0.8], [0.8, -0.8], [0.8, 0.8], [-0.8, 0.8]])
    vertices = np.column_stack([corners, 0.1 + 0.1 * corners @ [a, b]])
    image = render(vertices, np.array([[0, 1, 2], [0, 2, 3]]), camera)
    normal = np.array([-0.1 * a, -0.1 * b, 1.0])
    for i, j in [(9, 12), (4, 18), (14, 7)]:
        ray = np.array([(j + 0.5 - 12) / 22, (i + 0.5 - 9) / 22, 1.0]) @ camera.axes()
        expected = (0.1 - normal @ camera.position()) / (normal @ ray)
        place = camera.position() + expected * ray
        if np.abs(place[:2]).max() < 0.79:
            assert image.depth[i, j] == pytest.approx(expected, rel=1e-9)
            assert image.cloth[i, j]


def test_axes_are_those_of_opencv_and_the_aim_is_in_the_middle() -> None:
    axes = CameraConfig().axes()
    np.testing.assert_allclose(axes, [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=1e-12)
    for tilt, azimuth in [(0.0, 1.0), (0.5, 0.0), (0.9, -2.0)]:
        camera = CameraConfig(tilt=tilt, azimuth=azimuth, aim=(0.1, -0.2), height=0.7)
        axes, position = camera.axes(), camera.position()
        np.testing.assert_allclose(np.cross(axes[0], axes[1]), axes[2], atol=1e-12)
        assert position[2] == pytest.approx(0.7)
        towards = np.array([0.1, -0.2, 0]) - position
        np.testing.assert_allclose(towards / np.linalg.norm(towards), axes[2], atol=1e-12)


def test_a_principal_point_beside_the_middle_shifts_the_image() -> None:
    plain = image_of(folded(), SMALL)
    beside = CameraConfig(columns=160, rows=120, focal=147.5, principal=(90.0, 55.0))
    shifted = image_of(folded(), beside)
    np.testing.assert_allclose(shifted.depth[:-5, 10:], plain.depth[5:, :-10])
    np.testing.assert_allclose(shifted.points()[:-5, 10:], plain.points()[5:, :-10], atol=1e-12)


def test_the_mask_is_the_cloth_and_the_fold_hides_what_is_below() -> None:
    image = image_of(SQUARE.flat(), SMALL)
    assert image.cloth.sum() == pytest.approx((0.4 * 147.5 / 0.8) ** 2, rel=0.03)
    mesh = folded()
    heights = SMALL.table().heights(image_of(mesh, SMALL).points())
    assert heights.max() == pytest.approx(mesh[..., 2].max() * SCALE, abs=2e-4)
    # The cloth in the bare image lies where it is put.
    cloud = back_project(image_of(mesh, SMALL, at=(0.05, -0.03)))
    world = cloud.points[cloud.cloth] @ SMALL.axes() + SMALL.position()
    middle = (world.max(0) + world.min(0))[:2] / 2
    reach = (mesh.max((0, 1)) + mesh.min((0, 1)))[:2] / 2 * SCALE
    np.testing.assert_allclose(middle, reach + np.array([0.05, -0.03]), atol=0.004)


def test_what_is_behind_the_camera_or_below_the_table_is_not_seen() -> None:
    above = SQUARE.flat().astype(float) * SCALE + [0, 0, 2.0]
    assert not render(above, SQUARE.triangles(), SMALL).cloth.any()
    assert not render(above - [0, 0, 2.1], SQUARE.triangles(), SMALL).cloth.any()


def test_no_noise_changes_nothing_and_noise_is_of_the_size_asked_for() -> None:
    image = image_of(SQUARE.flat(), SMALL)
    np.testing.assert_allclose(noisy(image, SILENT, seed=0).depth, image.depth)
    blurred = noisy(image, NoiseConfig(**{**vars(SILENT), "axial": 0.001, "axial_growth": 0.002}), seed=0)
    assert (blurred.depth - image.depth).std() == pytest.approx(0.001 + 0.002 * 0.8**2, rel=0.03)
    stepped = noisy(image, NoiseConfig(**{**vars(SILENT), "step": 0.01}), seed=0)
    np.testing.assert_allclose(np.rint(1 / stepped.depth / 0.01), 1 / stepped.depth / 0.01, atol=1e-6)
    assert np.abs(stepped.depth - image.depth).max() < 0.8**2 * 0.01 * 0.51
    lossy = noisy(image, NoiseConfig(**{**vars(SILENT), "dropout": 0.2}), seed=0)
    assert (lossy.depth == 0).mean() == pytest.approx(0.2, abs=0.02)
    assert not lossy.cloth[lossy.depth == 0].any()
    spotted = noisy(image, NoiseConfig(**{**vars(SILENT), "holes": 4, "hole_radius": 5.0}), seed=0)
    assert 0 < (spotted.depth == 0).sum() <= 4 * 90


def test_grazing_angles_and_edges_are_lost() -> None:
    camera = CameraConfig(columns=64, rows=48, focal=59.0, tilt=1.2)
    image = render(*NOTHING, camera)
    angle = incidence(image)
    middle = angle[20:28, 28:36]
    np.testing.assert_allclose(middle.mean(), 1.2, atol=0.05)
    grazed = noisy(image, NoiseConfig(**{**vars(SILENT), "grazing": 1.2}), seed=0)
    assert (grazed.depth[angle > 1.21] == 0).all()
    assert (grazed.depth[(angle < 1.19) & (image.depth > 0)] > 0).all()
    high = render(SQUARE.flat().astype(float) * SCALE + [0, 0, 0.1], SQUARE.triangles(), SMALL)
    cut = noisy(high, NoiseConfig(**{**vars(SILENT), "edge_dropout": 1.0}), seed=0)
    lost = (cut.depth == 0) & (high.depth > 0)
    assert 300 < lost.sum() < 900
    assert not lost[50:70, 70:90].any()


def test_the_same_seed_gives_the_same_image() -> None:
    image = image_of(folded(), SMALL)
    first, again, other = (noisy(image, NoiseConfig(), seed=seed).depth for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
