"""The held likelihood against the plain one and against a mean squared error, by their gradients."""

import jax
import jax.numpy as jnp
import numpy as np

from clothkit.cloth.mesh import ProbabilisticMesh, nll
from clothkit.training.likelihood import held_nll

RANDOM = np.random.default_rng(0)
MESH = RANDOM.normal(size=(2, 32, 32, 3)).astype(np.float32)
MEAN = RANDOM.normal(size=(2, 32, 32, 3)).astype(np.float32)
STD = RANDOM.uniform(0.02, 0.5, (2, 32, 32, 3)).astype(np.float32)


def gradient_for_mean(hold):
    return jax.grad(lambda mean: jnp.sum(held_nll(MESH, ProbabilisticMesh(mean, STD), hold)))(MEAN)


def test_without_hold_it_is_the_likelihood():
    predicted = ProbabilisticMesh(MEAN, STD)
    np.testing.assert_array_equal(held_nll(MESH, predicted, 0.0), nll(MESH, predicted))


def test_wholly_held_means_feel_a_squared_error():
    direction = (MEAN - MESH).astype(np.float64)
    expected = direction / (STD.astype(np.float64) ** 2).mean((1, 2, 3), keepdims=True) / MEAN[0].size
    np.testing.assert_allclose(gradient_for_mean(1.0), expected, rtol=1e-3)


def test_half_held_means_feel_the_error_over_sigma():
    felt = np.asarray(gradient_for_mean(0.5)) / ((MEAN - MESH) / STD)
    np.testing.assert_allclose(felt, np.broadcast_to(felt[:, :1, :1, :1], felt.shape), rtol=1e-3)


def test_equal_sigmas_make_no_difference():
    equal = ProbabilisticMesh(MEAN, np.full_like(STD, 0.1))
    np.testing.assert_allclose(held_nll(MESH, equal, 0.7), nll(MESH, equal), rtol=1e-5)
