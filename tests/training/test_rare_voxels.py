"""VtM trained without rare voxels is VtM: the same estimates and gradients as of a net that weighs them with zero."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.cloth import voxels
from clothkit.models.layers import run
from clothkit.models.settings import VtMConfig
from clothkit.models.vtm import VtM, initial
from clothkit.runtime.errors import InputError
from clothkit.training import vtm as vtm_training
from clothkit.training.settings import TrainingConfig, TrainVtMConfig
from clothkit.training.vtm import EVERY, among, draw, narrowed, problem, states, taken, train_vtm, widened

SETTINGS = TrainVtMConfig(
    net=VtMConfig(hidden=12),
    training=TrainingConfig(recipe="fast", iterations=10, batch=16, validate_every=10, steps_per_call=10),
    noise=0.0,
    rare=1e-6,
)


@pytest.fixture(autouse=True)
def few_examples(monkeypatch):
    monkeypatch.setattr(vtm_training, "COUNTED", 256)


def test_a_narrowed_net_is_the_whole_one_with_weights_of_zero():
    random = np.random.default_rng(0)
    chosen = np.sort(random.choice(EVERY, 5000, replace=False))
    seen = jnp.asarray(random.random((3, *voxels.RESOLUTION)) < 0.1)
    narrow = narrowed(initial(SETTINGS.net, key=jax.random.key(1)), chosen)
    of_chosen = run(VtM(SETTINGS.net), narrow, among(chosen, seen))
    whole = run(VtM(SETTINGS.net), widened(narrow, chosen), seen)
    np.testing.assert_allclose(of_chosen.mesh.mean, whole.mesh.mean, atol=1e-5)
    np.testing.assert_allclose(of_chosen.mesh.std, whole.mesh.std, atol=1e-5)


def test_voxels_that_are_never_occupied_change_no_gradient(dataset):
    data, key = states(dataset), jax.random.key(3)
    batch, _ = draw(data, SETTINGS, key=jax.random.split(key)[0])
    chosen = np.flatnonzero(jnp.any(voxels.observe(batch), axis=0))
    assert 0.05 < len(chosen) / len(EVERY) < 0.7
    whole, narrow = problem(SETTINGS, dataset), problem(SETTINGS, dataset, chosen)
    params = whole.initial(jax.random.key(2))
    gradient, losses = whole.gradient(params, data, key)
    of_chosen, same_losses = narrow.gradient(narrowed(params, chosen), data, key)
    np.testing.assert_allclose(same_losses["loss"], losses["loss"], rtol=1e-4)
    for one, other in zip(jax.tree.leaves(of_chosen), jax.tree.leaves(narrowed(gradient, chosen)), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-4 * float(jnp.abs(other).max()))
    left_out = np.setdiff1d(EVERY, chosen)
    assert not np.any(gradient["layer_1"]["kernel"][left_out])


def test_rarer_voxels_go_first_and_all_stay_unless_told(dataset):
    data = states(dataset)
    often, seldom = (taken(data, replace(SETTINGS, rare=rare)) for rare in (0.1, 0.004))
    assert set(often) < set(seldom) < set(EVERY)
    # A cloth lies on the table, about its centre: there it is seen, at the far corner's top it never is.
    at = np.arange(len(EVERY)).reshape(voxels.RESOLUTION)
    assert at[16, 16, 0] in often
    assert at[0, 0, 15] not in seldom
    assert len(taken(data, replace(SETTINGS, rare=0.0))) == len(EVERY)


def test_a_share_that_leaves_no_voxels_is_told(dataset):
    with pytest.raises(InputError, match="rare"):
        taken(states(dataset), replace(SETTINGS, rare=1.0))


def test_a_trained_net_takes_all_voxels_and_scores_as_it_was_judged(dataset, tmp_path):
    trained = train_vtm(SETTINGS, dataset, dataset, work=tmp_path, key=jax.random.key(0))
    kernel = trained.params["layer_1"]["kernel"]
    assert kernel.shape == (len(EVERY), SETTINGS.net.hidden)
    left_out = np.setdiff1d(EVERY, taken(states(dataset), SETTINGS))
    assert not np.any(kernel[left_out])
    score = problem(SETTINGS, dataset).validate(trained.params)["score"]
    np.testing.assert_allclose(score, trained.score, rtol=1e-5)
