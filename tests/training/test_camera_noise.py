"""VtM's training inputs as a depth camera shows them."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import Viewport, observe
from clothkit.training.settings import CameraNoise, TrainVtMConfig
from clothkit.training.vtm import by_camera, displaced, stepped

VIEWPORT = Viewport(height=0.4, curve=2.0)
SILENT = CameraNoise(noise=0, bias=0, holes=0, radius=0, missing=0, shift=0, tilt=0, step=0)
MESHES = jnp.tile(SQUARE.flat() + np.float32([0, 0, 0.01]), (64, 1, 1, 1))
KEY = jax.random.key(3)


def test_without_noise_it_is_the_plain_observation() -> None:
    seen = by_camera(MESHES, SILENT, VIEWPORT, key=KEY)
    np.testing.assert_array_equal(seen, observe(MESHES, viewport=VIEWPORT))


def test_holes_are_round_and_hide_all_layers() -> None:
    folded = jnp.concatenate([MESHES[:, 16:][:, ::-1] + np.float32([0, 0, 0.02]), MESHES[:, 16:]], axis=1)
    seen = np.asarray(by_camera(folded, replace(SILENT, holes=1, radius=0.5), VIEWPORT, key=KEY))
    gone = np.asarray(observe(folded, viewport=VIEWPORT)).any(-1) & ~seen.any(-1)
    sizes = gone.sum((1, 2))
    assert (sizes == 0).any(), "half of the examples have no hole"
    for hole in gone[sizes > 3]:
        place = np.argwhere(hole)
        # No column between two that are missing is left, nor is the hole larger than twice its largest radius.
        assert np.ptp(place, axis=0).max() <= 2 * 0.5 * 16
        middle = place.mean(0).round().astype(int)
        assert hole[tuple(middle)]


def test_missing_points_leave_fewer_columns() -> None:
    full = np.asarray(observe(MESHES, viewport=VIEWPORT)).any(-1).sum()
    seen = np.asarray(by_camera(MESHES, replace(SILENT, missing=1.0), VIEWPORT, key=KEY)).any(-1).sum((1, 2))
    assert seen.sum() < full
    assert seen.max() > 4 * seen.min(), "each example draws its own share"


@pytest.mark.parametrize("bias", [0.0, 0.02])
def test_bias_moves_whole_examples(bias: float) -> None:
    seen = np.asarray(by_camera(MESHES, replace(SILENT, bias=bias), VIEWPORT, key=KEY))
    levels = seen.sum(-1)
    tops = [set(level[level > 0]) for level in levels]
    assert all(len(top) <= 2 for top in tops)
    assert (len(set.union(*tops)) > 2) == (bias > 0)


def test_a_tilted_table_raises_one_side_of_the_cloth_and_lowers_the_other() -> None:
    high, even = MESHES + np.float32([0, 0, 0.2]), Viewport(height=0.4)
    tops = np.asarray(by_camera(high, replace(SILENT, tilt=0.05), even, key=KEY)).sum(-1).astype(float)
    slopes = []
    for top in tops:
        x, y = np.nonzero(top)
        design = np.stack([x, y, np.ones(len(x))], axis=1)
        slope, rest = np.linalg.lstsq(design, top[x, y], rcond=None)[:2]
        slopes.append(slope[:2])
        assert rest[0] / len(x) < 0.3, "a plane, up to the height of a voxel"
    # A column is 1/16 wide, a voxel 0.025 high.
    np.testing.assert_allclose(np.std(slopes, axis=0), 0.05 / 16 / 0.025, rtol=0.35)


@given(st.lists(st.floats(0, 0.375, width=32), min_size=1, max_size=20), st.floats(0.001, 0.05), st.floats(0, 1))
def test_stepped_heights_are_whole_steps_apart_and_at_most_half_a_step_off(
    heights: list[float], step: float, begin: float
) -> None:
    z, start = jnp.float32([heights]), jnp.float32([[begin]])
    found = np.asarray(stepped(z, jnp.float32([[step]]), start))
    assert np.abs(found - z).max() <= step / 2 + 1e-6
    apart = (found - found[0, 0]) / step
    np.testing.assert_allclose(apart, np.round(apart), atol=1e-3)
    np.testing.assert_array_equal(stepped(z, jnp.zeros((1, 1)), start), z)


def test_the_observed_centre_moves_the_mesh_alone_in_the_plane() -> None:
    settings = TrainVtMConfig(camera=replace(SILENT, shift=0.02))
    moved = np.asarray(displaced(MESHES, settings, key=KEY)) - MESHES
    np.testing.assert_allclose(np.ptp(moved, axis=(1, 2)), 0, atol=1e-6)
    np.testing.assert_allclose(moved[..., 2], 0)
    assert 0.01 < moved[:, 0, 0, :2].std() < 0.03
    np.testing.assert_array_equal(displaced(MESHES, TrainVtMConfig(), key=KEY), MESHES)
