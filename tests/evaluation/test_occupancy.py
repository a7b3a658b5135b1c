"""Eq. (16): exact integrals against logarithms in double precision, and by hand."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from clothkit.cloth import voxels
from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import Viewport
from clothkit.evaluation.occupancy import TALL, differences, occluded_occupancy, occupancy


def prediction(seed: int, *, spread: float = 0.1, batch: int = 1) -> ProbabilisticMesh:
    """A crumpled cloth, some of it outside the viewport."""
    rng = np.random.default_rng(seed)
    mean = SQUARE.flat() * np.array([1.5, 1.2, 1], np.float32) + 0.05 * rng.normal(size=(batch, 32, 32, 3))
    mean[..., 2] = 0.05 + mean[..., 2]
    std = rng.uniform(0.01, spread, mean.shape)
    return ProbabilisticMesh(mean.astype(np.float32), std.astype(np.float32))


def by_logarithms(mesh: ProbabilisticMesh) -> np.ndarray:
    """The sum of log(1 - p) over vertices, in double precision."""
    mean, std = (np.asarray(part, np.float64).reshape(-1, 3, 1) for part in mesh)
    z = np.linspace(0, 0.125, 17)
    z[[0, -1]] = -np.inf, np.inf
    edges = (np.linspace(-1, 1, 33), np.linspace(-1, 1, 33), z)
    shares = [np.diff(norm.cdf(edge, mean[:, i], std[:, i])) for i, edge in enumerate(edges)]
    empty = np.zeros((32, 32, 16))
    for x, y, z in zip(*shares, strict=True):
        empty += np.log1p(-np.minimum(np.einsum("x,y,z->xyz", x, y, z), 1 - 1e-15))
    return -np.expm1(empty)


def test_it_is_the_product_of_eq_16_in_double_precision() -> None:
    mesh = prediction(0, batch=2)
    found = np.asarray(occupancy(mesh))
    for i in range(2):
        one = ProbabilisticMesh(mesh.mean[i], mesh.std[i])
        np.testing.assert_allclose(found[i], by_logarithms(one), atol=2e-5)


@given(st.floats(-1.2, 1.2), st.floats(-1.2, 1.2), st.floats(-0.1, 0.2), st.floats(0.01, 0.5))
def test_a_cloth_of_equal_vertices_by_hand(x: float, y: float, z: float, std: float) -> None:
    """n equal vertices: 1 - (1 - p)^n; the shares of one sum to its probability of being above the viewport's floor."""
    mean = np.broadcast_to(np.array([x, y, z], np.float32), (1, 32, 32, 3))
    found = np.asarray(occupancy(ProbabilisticMesh(mean, np.full_like(mean, std))), np.float64)[0]
    share = 1 - (1 - np.minimum(found, 1 - 1e-7)) ** (1 / 1024)
    inside = np.prod([norm.cdf(1, at, std) - norm.cdf(-1, at, std) for at in (x, y)])
    # Where the cloth is all but certain, float32 can't tell how certain.
    if found.max() < 0.999:
        assert share.sum() == pytest.approx(inside, abs=2e-3)
    assert ((found >= 0) & (found <= 1)).all()


def test_a_certain_prediction_is_the_voxels_of_its_mesh() -> None:
    rng = np.random.default_rng(2)
    # In the middle of voxels, so that nothing spills over.
    mean = (rng.integers([32, 32, 16], size=(1, 32, 32, 3)) + 0.5) / [16, 16, 128] - [1, 1, 0]
    certain = ProbabilisticMesh(mean.astype(np.float32), np.full(mean.shape, 1e-5, np.float32))
    truth = np.asarray(voxels.of_mesh(certain.mean))
    np.testing.assert_allclose(occupancy(certain), truth, atol=1e-5)
    assert float(differences(occupancy(certain), truth)[0]) == pytest.approx(0, abs=1e-6)


def test_a_certain_prediction_occluded_is_what_a_camera_sees_of_its_mesh() -> None:
    rng = np.random.default_rng(3)
    mesh = SQUARE.flat() + np.array([0.013, 0.017, 0.004]) + rng.normal(0, [0.003, 0.003, 0.02], (1, 32, 32, 3))
    certain = ProbabilisticMesh(mesh.astype(np.float32), np.full(mesh.shape, 1e-6, np.float32))
    found = np.asarray(occluded_occupancy(certain, key=jax.random.key(0)))
    # But for a vertex that lies on the border of voxels.
    assert np.mean(np.abs(found - np.asarray(voxels.observe(certain.mean))) > 1e-3) < 1e-3


def test_what_is_seen_of_one_uncertain_height_by_hand() -> None:
    """A cloth rolled up in one voxel's column, but for one vertex above: no midpoint of it is as high."""
    mean = np.broadcast_to(np.array([0.03, 0.03, 0.001], np.float32), (1, 32, 32, 3)).copy()
    std = np.full_like(mean, 1e-6)
    mean[0, 5, 5, 2], std[0, 5, 5, 2] = 0.06, 0.01
    found = np.asarray(occluded_occupancy(ProbabilisticMesh(mean, std), draws=2000, key=jax.random.key(1)))[0, 16, 16]
    edges = np.arange(16) * 0.125 / 16
    np.testing.assert_allclose(found, np.where(edges > 0, norm.sf(edges, 0.06, 0.01), 1), atol=0.04)


def test_what_is_above_or_below_the_viewport_counts_at_its_ends() -> None:
    mean = np.broadcast_to(np.array([0.03, 0.03, 0.0], np.float32), (2, 32, 32, 3)).copy()
    mean[0, ..., 2], mean[1, ..., 2] = -1, 1
    found = np.asarray(occupancy(ProbabilisticMesh(mean, np.full_like(mean, 0.01))))
    assert found[0, 16, 16].tolist() == pytest.approx([1] + [0] * 15, abs=1e-6)
    assert found[1, 16, 16].tolist() == pytest.approx([0] * 15 + [1], abs=1e-6)


def test_differences_by_hand() -> None:
    a = np.zeros((2, 32, 32, 16), np.float32)
    a[0, 3, 4, 5], a[1, 0, 0, 0] = 0.25, 1
    truth = np.zeros(a.shape, bool)
    truth[0, 3, 4, 5] = truth[0, 0, 0, 0] = True
    np.testing.assert_allclose(differences(a, truth), [1.75 / 16384, 1 / 16384], rtol=1e-6)


def test_the_high_viewport_is_four_times_finer_in_z() -> None:
    """Height 0.25 in 16 voxels, width 2 in 32: what the paper's text says of the ratio."""
    assert Viewport(height=0.25) == TALL
    assert (2 / 32) / (TALL.height / 16) == 4
