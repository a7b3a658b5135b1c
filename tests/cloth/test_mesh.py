import jax
import numpy as np
import pytest
import scipy.stats

from clothkit.cloth.mesh import (
    ProbabilisticMesh,
    best_label,
    distance,
    distance_aligned,
    error,
    nll,
    whiten,
    whiten_probabilistic,
)
from clothkit.cloth.symmetry import relabel
from clothkit.cloth.topology import SQUARE

RNG = np.random.default_rng(1)
MESH = RNG.normal(size=(2, 7, 7, 3)).astype(np.float32)
PROBABILISTIC = ProbabilisticMesh(
    RNG.normal(size=(2, 7, 7, 3)).astype(np.float32), RNG.uniform(0.01, 2, (2, 7, 7, 3)).astype(np.float32)
)


def test_nll_is_scipys() -> None:
    expected = -scipy.stats.norm(*PROBABILISTIC).logpdf(MESH).mean((1, 2, 3))
    np.testing.assert_allclose(nll(MESH, PROBABILISTIC), expected, rtol=1e-5)


def test_whitening_gives_mean_zero_and_deviation_one() -> None:
    white = np.asarray(whiten(MESH * [3, 1, 0.2] + [1, 2, 3]))
    np.testing.assert_allclose(white.mean((1, 2)), 0, atol=1e-5)
    np.testing.assert_allclose(white.std((1, 2)), 1, rtol=1e-4)


def test_whitening_rescales_sigma_like_the_mean() -> None:
    white = whiten_probabilistic(PROBABILISTIC)
    spread = PROBABILISTIC.mean.std((1, 2), keepdims=True)
    np.testing.assert_allclose(white.std, PROBABILISTIC.std / spread, rtol=1e-4)
    np.testing.assert_allclose(white.mean, whiten(PROBABILISTIC.mean), rtol=1e-4)


def test_a_flat_cloth_whitens_to_finite_values_with_finite_gradients() -> None:
    white, gradient = jax.value_and_grad(lambda m: (whiten(m) ** 2).sum())(SQUARE.flat())
    assert np.isfinite(white)
    assert np.isfinite(gradient).all()
    assert (np.asarray(whiten(SQUARE.flat()))[..., 2] == 0).all()


def test_distance_is_in_cloth_lengths() -> None:
    assert float(distance(SQUARE.flat() + np.float32([1.4, 0, 0]), SQUARE.flat())) == pytest.approx(1, rel=1e-4)
    moved = SQUARE.flat() + np.float32([1.4, 0.2, 0.1])
    assert float(distance_aligned(moved, SQUARE.flat())) == pytest.approx(0, abs=5e-5)


@pytest.mark.parametrize("k", range(8))
def test_error_is_blind_to_labels(k: int) -> None:
    assert float(error(relabel(MESH[0], k), MESH[0])) == pytest.approx(0, abs=5e-5)
    moved = relabel(MESH[0], k) + np.float32([0.3, 0, 0])
    assert float(error(moved, MESH[0])) > 0.1
    assert float(error(moved, MESH[0], aligned=True)) == pytest.approx(0, abs=5e-5)
    label = int(best_label(relabel(MESH[0], k), MESH[0]))
    np.testing.assert_array_equal(relabel(MESH[0], label), relabel(MESH[0], k))


def test_every_mesh_of_a_batch_has_labels_of_its_own() -> None:
    truths = RNG.normal(size=(3, 7, 7, 3)).astype(np.float32)
    meshes = np.stack([np.asarray(relabel(truth, k)) for truth, k in zip(truths, (3, 0, 6), strict=True)])
    off = np.float32([[0.14, 0, 0], [0, 0.28, 0], [0, 0, 0.42]])[:, None, None]
    np.testing.assert_allclose(error(meshes + off, truths), [0.1, 0.2, 0.3], rtol=1e-4)
    np.testing.assert_allclose(error(meshes + off, truths, aligned=True), np.zeros(3), atol=5e-5)
    assert best_label(meshes, truths).tolist() == [3, 0, 6]
