"""The losses and the sign-sum rule against values computed another way."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.symmetry import equivalents
from clothkit.cloth.topology import SQUARE
from clothkit.models.forward import predict
from clothkit.models.layers import probabilistic_mesh
from clothkit.models.pemd import PEMD, initial
from clothkit.models.settings import PEMDConfig
from clothkit.training import pemd as pemd_training
from clothkit.training.pemd import direction, draw, losses
from clothkit.training.recipe import sign_sum
from clothkit.training.settings import TrainingConfig, TrainPEMDConfig
from clothkit.training.vtm import loss_vtm

NET = PEMDConfig(latent=3, encoder=(7, 6), manipulation=5, decoder=(4, 8))


def test_sigma_is_exp_plus_a_hundredth():
    units = np.random.default_rng(0).normal(size=(2, 32 * 32 * 6)).astype(np.float32)
    mesh = probabilistic_mesh(jnp.asarray(units))
    vertex = units[1].reshape(*SQUARE.shape, 6)[5, 9]
    np.testing.assert_allclose(mesh.mean[1, 5, 9], vertex[:3], rtol=1e-6)
    np.testing.assert_allclose(mesh.std[1, 5, 9], np.exp(vertex[3:]) + 0.01, rtol=1e-6)


@pytest.mark.parametrize("least_std", [0.01, 0.002])
def test_sigma_is_never_below_the_least_that_the_config_names(least_std):
    config = dataclasses.replace(NET, least_std=least_std)
    certain = jax.tree.map(jnp.zeros_like, initial(config, key=jax.random.key(0)))
    certain["D"]["mesh"]["bias"] -= 50.0
    stds = PEMD(config).decode(certain, jnp.zeros((1, NET.latent))).std
    np.testing.assert_allclose(stds, least_std, rtol=1e-6)
    thinned = PEMD(config).decode(certain, jnp.zeros((1, NET.latent)), stride=2).std
    np.testing.assert_allclose(thinned, least_std, rtol=1e-6)


def batch(dataset, n):
    return draw(pemd_training.sequences(dataset), n, 4, key=jax.random.key(1))


def test_loss_s_sums_likelihoods_over_steps_and_loss_p_is_a_mean_square(dataset):
    examples, params = batch(dataset, 2), initial(NET, key=jax.random.key(0))
    predicted, found = predict(PEMD(NET), params, examples.state, examples.manipulations)
    steps = [
        -norm.logpdf(examples.outcomes[:, i], predicted.mean[i], predicted.std[i]).mean((1, 2, 3)) for i in range(2)
    ]
    loss_s, loss_p = losses(PEMD(NET), params, examples)
    np.testing.assert_allclose(loss_s, np.mean(steps[0] + steps[1]), rtol=1e-5)
    misses = [np.asarray(found.shifts[i]) - np.asarray(examples.shifts[:, i]) for i in range(2)]
    np.testing.assert_allclose(loss_p, np.mean(np.square(misses)), rtol=1e-5)


def test_sign_sum_by_hand():
    shape, position = jnp.array([3.0, -0.1, 2.0, 0.0, -5.0, 0.0]), jnp.array([0.2, -9.0, -1e-9, 4.0, 0.0, 0.0])
    np.testing.assert_array_equal(sign_sum(shape, position), [1, -1, 0, 1, -1, 0])


def test_paper_direction_is_the_sign_sum_of_finite_differences(dataset):
    examples, params = batch(dataset, 2), initial(NET, key=jax.random.key(0))
    settings = TrainPEMDConfig(net=NET, training=TrainingConfig(recipe="paper"))
    found, by_name = direction(PEMD(NET), settings, params, examples)
    assert set(by_name) == {"loss_s", "loss_p"}
    rng = np.random.default_rng(0)
    with jax.enable_x64(True):
        precise = jax.tree.map(lambda x: jnp.asarray(np.asarray(x), jnp.float64), (params, examples))
        for module, layer in (("E", "layer_1"), ("M", "layer_1"), ("M", "skip_4_6"), ("M", "layer_15"), ("D", "mesh")):
            kernel = np.asarray(precise[0][module][layer]["kernel"])
            for _ in range(3):
                at = tuple(int(rng.integers(size)) for size in kernel.shape)
                slopes = _slopes(precise, module, layer, at)
                expected = np.sign(np.sign(slopes[0]) + np.sign(slopes[1]))
                assert float(found[module][layer]["kernel"][at]) == expected


def _slopes(precise, module, layer, at):
    """The differences of loss_s and loss_p between two values of one weight."""
    params, examples = precise
    values = []
    for step in (1e-5, -1e-5):
        weights = {**params[module], layer: {**params[module][layer]}}
        weights[layer]["kernel"] = params[module][layer]["kernel"].at[at].add(step)
        values.append(np.array(losses(PEMD(NET), {**params, module: weights}, examples)))
    # A weight that a loss does not reach leaves it exactly as it is.
    return values[0] - values[1]


def test_fast_direction_is_the_gradient_of_the_weighted_sum(dataset):
    examples, params = batch(dataset, 2), initial(NET, key=jax.random.key(0))
    settings = TrainPEMDConfig(net=NET, training=TrainingConfig(recipe="fast"), shift_weight=3.0)
    found, _ = direction(PEMD(NET), settings, params, examples)
    shape, position = (
        jax.grad(lambda p, i=i: losses(PEMD(NET), p, examples, hold=settings.hold)[i])(params) for i in range(2)
    )
    jax.tree.map(lambda d, s, p: np.testing.assert_allclose(d, s + 3 * p, rtol=1e-4, atol=1e-5), found, shape, position)


def test_decoder_gets_loss_s_only(dataset):
    examples, params = batch(dataset, 1), initial(NET, key=jax.random.key(0))
    settings = TrainPEMDConfig(net=NET, training=TrainingConfig(recipe="paper"))
    found, _ = direction(PEMD(NET), settings, params, examples)
    shape = jax.grad(lambda p: losses(PEMD(NET), p, examples)[0])(params)
    jax.tree.map(lambda d, g: np.testing.assert_array_equal(d, np.sign(g)), found["D"], shape["D"])


def test_vtm_loss_is_the_least_of_eight_and_so_is_its_gradient(dataset):
    rng = np.random.default_rng(2)
    mesh = jnp.asarray(dataset.vertices[:, 2])
    mean = jnp.asarray(mesh[::-1] + rng.normal(0, 0.05, mesh.shape).astype(np.float32))
    std = jnp.asarray(rng.uniform(0.05, 0.2, mesh.shape).astype(np.float32))

    def brute(mean):
        z = (equivalents(mesh) - mean) / std
        return jnp.min(jnp.mean(z**2 / 2 + jnp.log(std) + jnp.log(2 * jnp.pi) / 2, axis=(-3, -2, -1)), axis=0)

    np.testing.assert_allclose(loss_vtm(mesh, ProbabilisticMesh(mean, std)), brute(mean), rtol=1e-5)
    found = jax.grad(lambda m: loss_vtm(mesh, ProbabilisticMesh(m, std)).sum())(mean)
    np.testing.assert_allclose(found, jax.grad(lambda m: brute(m).sum())(mean), atol=1e-6)
