import jax
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import Viewport, double, observe, observe_noisily, occlude, of_mesh, voxelise

RNG = np.random.default_rng(2)


def test_voxelise_is_the_brute_force_one() -> None:
    points = RNG.uniform([-1.3, -1.3, -0.05], [1.3, 1.3, 0.2], (300, 3)).astype(np.float32)
    expected = np.zeros((32, 32, 16), bool)
    for x, y, z in points:
        i, j, k = int(np.floor((x + 1) * 16)), int(np.floor((y + 1) * 16)), int(np.floor(z * 128))
        if 0 <= i < 32 and 0 <= j < 32:
            expected[i, j, min(max(k, 0), 15)] = True
    np.testing.assert_array_equal(voxelise(points), expected)
    np.testing.assert_array_equal(voxelise(np.stack([points, points]))[1], expected)


def test_occlusion_is_the_brute_force_one() -> None:
    voxels = RNG.random((8, 8, 16)) < 0.1
    expected = voxels.copy()
    for i, j, k in np.argwhere(voxels):
        expected[i, j, :k] = True
    np.testing.assert_array_equal(occlude(jax.numpy.asarray(voxels)), expected)


def test_doubling_puts_midpoints_between_neighbours() -> None:
    mesh = RNG.normal(size=(5, 5, 3)).astype(np.float32)
    dense = np.asarray(double(mesh))
    assert dense.shape == (9, 9, 3)
    np.testing.assert_array_equal(dense[::2, ::2], mesh)
    np.testing.assert_allclose(dense[1::2, ::2], (mesh[1:] + mesh[:-1]) / 2, rtol=1e-6)
    np.testing.assert_allclose(dense[::2, 1::2], (mesh[:, 1:] + mesh[:, :-1]) / 2, rtol=1e-6)
    middle = (mesh[1:, 1:] + mesh[1:, :-1] + mesh[:-1, 1:] + mesh[:-1, :-1]) / 4
    np.testing.assert_allclose(dense[1::2, 1::2], middle, rtol=1e-5, atol=1e-6)


def test_the_flat_cloth_is_a_solid_square_one_voxel_high() -> None:
    seen = np.asarray(observe(SQUARE.flat()))
    inside = np.arange(32) >= 4
    inside &= inside[::-1]
    assert seen[inside][:, inside][:, :, 0].all()
    assert not seen[..., 1:].any()


def test_a_meshs_own_voxels_are_those_of_its_vertices_alone() -> None:
    """Neither midpoints nor what lies below, which a camera sees too."""
    mesh = SQUARE.flat() * np.float32([2, 2, 1])
    mesh[10:20, 10:20, 2] = 0.06
    expected = np.zeros((32, 32, 16), bool)
    for x, y, z in mesh.reshape(-1, 3):
        if max(abs(x), abs(y)) < 1:
            expected[int((x + 1) * 16), int((y + 1) * 16), int(z * 128)] = True
    found, seen = np.asarray(of_mesh(mesh)), np.asarray(observe(mesh))
    np.testing.assert_array_equal(found, expected)
    # Vertices are farther apart than voxels are wide, midpoints are not.
    assert found.any(-1).sum() < 600
    assert seen[1:-1, 1:-1, 0].all()
    assert seen[expected[..., 7]][:, :8].all()


def test_noise_is_drawn_from_its_key_and_vanishes_with_its_scale() -> None:
    first, second = (
        np.asarray(observe_noisily(SQUARE.flat(), noise=0.025, noise_z=0.01, key=jax.random.key(k))) for k in (0, 1)
    )
    assert (first != second).any()
    silent = observe_noisily(SQUARE.flat(), noise=0.0, noise_z=0.0, key=jax.random.key(0))
    np.testing.assert_array_equal(silent, observe(SQUARE.flat()))


@given(st.floats(0.01, 2), st.floats(1, 4), st.floats(0, 1))
def test_levels_and_heights_are_each_others_inverse(height: float, curve: float, share: float) -> None:
    viewport = Viewport(height=height, curve=curve)
    z = np.float32(share * height)
    np.testing.assert_allclose(viewport.z(viewport.level(jax.numpy.asarray(z))), z, rtol=1e-4, atol=1e-6)
    assert float(viewport.z(np.array(16, np.float32))) == np.float32(height)


def test_a_curved_viewport_is_finer_near_the_table() -> None:
    viewport = Viewport(height=0.4, curve=2.0)
    points = RNG.uniform([-1, -1, -0.05], [1, 1, 0.5], (300, 3)).astype(np.float32)
    bounds = [0.4 * (k / 16) ** 2 for k in range(17)]
    expected = np.zeros((32, 32, 16), bool)
    for x, y, z in points:
        below = [k for k in range(16) if bounds[k] <= z]
        expected[int((x + 1) * 16), int((y + 1) * 16), max(below, default=0)] = True
    np.testing.assert_array_equal(voxelise(points, viewport=viewport), expected)
    # Layers 2 mm apart on a cloth of 0.4 m are told apart: no two of the first three are in one voxel.
    layers = np.array([[0, 0, 0.0035 + 0.007 * k] for k in range(3)], np.float32)
    assert np.asarray(voxelise(layers, viewport=viewport)).sum() == 3
