"""Measures of uncertainty, and the expected error that is learned from them, against formulas worked by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.cloth.mesh import ProbabilisticMesh, distance_aligned, smooth_distance
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.planning.expected_error import LEAST, LEAST_SURPRISE, ExpectedError, Signs, fit
from clothkit.planning.measures import measure
from clothkit.planning.mesh_representation import MESH


def predictions(seed: int, nets: int, batch: int = 3) -> list[ProbabilisticMesh]:
    rng = np.random.default_rng(seed)
    return [
        ProbabilisticMesh(
            rng.normal(size=(batch, 32, 32, 3)).astype(np.float32),
            rng.uniform(0.01, 0.1, size=(batch, 32, 32, 3)).astype(np.float32),
        )
        for _ in range(nets)
    ]


def test_measures_are_means_over_all_pairs_of_nets() -> None:
    nets = predictions(0, 3)
    found = measure(nets)
    pairs = [(0, 1), (0, 2), (1, 2)]
    expected = np.mean([MESH.difference(nets[a], nets[b]) for a, b in pairs], axis=0)
    np.testing.assert_allclose(found.difference, expected, rtol=1e-5)
    apart = np.zeros(3)
    for a, b in pairs:
        offset = nets[a].mean - nets[b].mean
        offset = offset - offset.mean(axis=(1, 2), keepdims=True)
        apart += np.sqrt((offset**2).sum(-1)).mean(axis=(1, 2)) / CLOTH_LENGTH / 3
    np.testing.assert_allclose(found.distance, apart, rtol=1e-4)
    variance = np.mean([(net.std**2).sum(-1).mean(axis=(1, 2)) for net in nets], axis=0)
    np.testing.assert_allclose(found.sigma, np.sqrt(variance) / CLOTH_LENGTH, rtol=1e-5)


def test_a_single_net_has_its_sigma_alone() -> None:
    found = measure(predictions(1, 1))
    assert not np.any(found.difference)
    assert not np.any(found.distance)
    assert np.all(np.asarray(found.sigma) > 0)


def probes(seed: int, count: int = 4000) -> tuple[Signs, np.ndarray, np.ndarray]:
    """Probes with error 2 (step + 1) distance^0.7 sigma^0.3 surprise^0.2, times noise of a known mean."""
    rng = np.random.default_rng(seed)
    signs = Signs(*(rng.uniform(low, high, count) for low, high in ((0.01, 0.3), (0.01, 0.1), (0, 10))))
    step = rng.integers(0, 3, count)
    powers = (signs.distance + LEAST) ** 0.7 * (signs.sigma + LEAST) ** 0.3 * (signs.surprise + LEAST_SURPRISE) ** 0.2
    return signs, step, 2 * (step + 1) * powers * rng.lognormal(0, 0.4, count)


def test_the_fit_finds_powers_offsets_and_the_mean() -> None:
    signs, step, error = probes(0)
    found = fit(signs, step, error)
    np.testing.assert_allclose(found.slope, [0.7, 0.3, 0.2], atol=0.03)
    # The mean of a lognormal factor is exp(sigma^2 / 2).
    np.testing.assert_allclose(np.exp(found.offset), 2 * np.arange(1, 4) * np.exp(0.08), rtol=0.15)
    expected = np.asarray(found(signs, step))
    assert (error / expected).mean() == pytest.approx(1, abs=1e-3)


def test_the_interval_holds_its_share_of_other_probes() -> None:
    found = fit(*probes(0))
    signs, step, error = probes(1)
    low, high = found.interval(np.asarray(found(signs, step)), 0.8)
    assert ((low <= error) & (error <= high)).mean() == pytest.approx(0.8, abs=0.03)


def test_an_error_never_falls_where_nets_are_farther_apart() -> None:
    rng = np.random.default_rng(2)
    signs = Signs(*(rng.uniform(0.01, 0.3, 200) for _ in range(3)))
    # Errors that fall with every sign: slopes stay at zero.
    found = fit(signs, np.zeros(200, int), 0.01 / (signs.distance * signs.sigma * signs.surprise))
    np.testing.assert_allclose(found.slope, 0, atol=1e-6)


def test_steps_without_probes_are_told() -> None:
    with pytest.raises(ValueError, match="step 1"):
        fit(Signs(*(np.ones(4) for _ in range(3))), np.array([0, 0, 2, 2]), np.ones(4))


def test_gradients_are_finite_where_nets_agree_and_meshes_coincide() -> None:
    mean, std = jnp.zeros((1, 4, 4, 3)), jnp.full((1, 4, 4, 3), 0.01)
    found = ExpectedError(np.zeros(1), np.array([0.7, 0.3, 0.2]), np.ones(3))

    def value(mean: jax.Array) -> jax.Array:
        measures = measure([ProbabilisticMesh(mean, std), ProbabilisticMesh(jnp.zeros_like(mean), std)])
        signs = Signs(measures.distance, measures.sigma, jnp.zeros(1))
        return jnp.sum(found(signs, 0)) + jnp.sum(smooth_distance(mean, jnp.zeros_like(mean)))

    assert np.isfinite(jax.grad(value)(mean)).all()


def test_the_smooth_distance_is_the_distance() -> None:
    a, b = (np.random.default_rng(k).normal(size=(2, 8, 8, 3)).astype(np.float32) for k in range(2))
    np.testing.assert_allclose(smooth_distance(a, b), distance_aligned(a, b), rtol=1e-4)
