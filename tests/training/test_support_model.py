"""The support model: it tells recorded manipulations from random ones, by the state."""

import jax
import jax.numpy as jnp
import numpy as np

from clothkit.manipulation.draws import random_manipulations
from clothkit.models import support_model
from clothkit.models.settings import SupportModelConfig
from clothkit.models.support_model import Layer, SupportModel
from clothkit.training.settings import SupportTrainingConfig
from clothkit.training.support_model import contrasted, recorded_inputs, swapped, train
from tests import toy_dataset
from tests.planning import toy

SETTINGS = SupportTrainingConfig(net=SupportModelConfig(hidden=(32,)), iterations=600, batch=32)


def test_recorded_manipulations_are_less_surprising_than_random_ones() -> None:
    dataset = toy_dataset.dataset(4)
    found = train(toy.MODEL, toy.NETS[0], dataset, SETTINGS)
    latents, manipulations = recorded_inputs(toy.MODEL, toy.NETS[0], dataset)
    random = np.asarray(random_manipulations((len(latents),), key=jax.random.key(1)))
    known, unknown = (
        np.asarray(support_model.surprise(found, support_model.inputs(toy.MODEL, latents, part)))
        for part in (manipulations, random)
    )
    # log 2 tells nothing.
    assert np.median(known) < np.log(2) < 2 < np.median(unknown)
    assert (known[:, None] < unknown).mean() > 0.9


def test_stretches_of_a_sequence_give_true_and_predicted_latents() -> None:
    dataset = toy_dataset.dataset(2)
    latents, manipulations = recorded_inputs(toy.MODEL, toy.NETS[0], dataset)
    # Six stretches a sequence: three that begin at the start, two after it, one after that.
    assert latents.shape == (12, 3072)
    np.testing.assert_array_equal(manipulations[:3], toy_dataset.MANIPULATIONS)
    np.testing.assert_array_equal(latents[0], dataset.vertices[0, 0].ravel())
    expected = toy.step(toy.NETS[0], latents[0], jnp.zeros(1), jnp.asarray(manipulations[0]))[0]
    np.testing.assert_allclose(latents[1], expected, atol=1e-6)


def test_surprise_by_hand() -> None:
    # One hidden unit, silu(2 (3 - 1) / 0.5), and its half as the logit.
    net = SupportModel(
        np.ones(1), np.full(1, 0.5), (Layer(np.full((1, 1), 2.0), np.zeros(1)), Layer(np.full((1, 1), 0.5), np.ones(1)))
    )
    unit = 8 / (1 + np.exp(-8.0))
    expected = np.log1p(np.exp(-(0.5 * unit + 1)))
    np.testing.assert_allclose(support_model.surprise(net, jnp.array([3.0])), expected, rtol=1e-5)


def test_contrasted_manipulations_keep_some_parts_and_which_hand_comes_first_means_nothing() -> None:
    recorded = np.tile(toy_dataset.MANIPULATIONS[:1], (2000, 1)) + np.float32([0.1, 0, 0, 0, 0, 0])
    random = np.asarray(contrasted(jnp.asarray(recorded), jax.random.key(0)))
    assert abs((random[:, :4] == recorded[:, :4]).all(1).mean() - 0.4) < 0.05
    assert abs((random[:, 4:] == recorded[:, 4:]).all(1).mean() - 0.1) < 0.03
    exchanged = np.asarray(swapped(jnp.asarray(recorded), jax.random.key(0)))
    other = recorded[:, [2, 3, 0, 1, 4, 5]]
    assert abs((exchanged == other).all(1).mean() - 0.5) < 0.05
    assert ((exchanged == other) | (exchanged == recorded)).all()
