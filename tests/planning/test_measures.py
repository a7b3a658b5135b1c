"""Measures of uncertainty against formulas worked by hand."""

import jax
import jax.numpy as jnp
import numpy as np

from clothkit.cloth.mesh import ProbabilisticMesh, distance_aligned, smooth_distance
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.measures import measure
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.model_error import LEAST, SIGNS


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


def test_gradients_are_finite_where_nets_agree_and_meshes_coincide() -> None:
    mean, std = jnp.zeros((1, 4, 4, 3)), jnp.full((1, 4, 4, 3), 0.01)
    found = ErrorMap(SIGNS, np.array(LEAST), np.zeros(1), np.array([0.7, 0.3, 0.2]), np.ones(1), np.ones((1, 3)))

    def value(mean: jax.Array) -> jax.Array:
        measures = measure([ProbabilisticMesh(mean, std), ProbabilisticMesh(jnp.zeros_like(mean), std)])
        return jnp.sum(found((measures.distance, measures.sigma, jnp.zeros(1)), 0)) + jnp.sum(
            smooth_distance(mean, jnp.zeros_like(mean))
        )

    assert np.isfinite(jax.grad(value)(mean)).all()


def test_the_smooth_distance_is_the_distance() -> None:
    a, b = (np.random.default_rng(k).normal(size=(2, 8, 8, 3)).astype(np.float32) for k in range(2))
    np.testing.assert_allclose(smooth_distance(a, b), distance_aligned(a, b), rtol=1e-4)
