"""What nets expect of a plan, spelled out in the labels of the state."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from clothkit.cloth.mesh import whiten_probabilistic
from clothkit.cloth.symmetry import relabel_manipulation
from clothkit.cloth.topology import PAPERS_CLOTH, SQUARE
from clothkit.planning import predict as prediction
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.predict import differences, predict
from tests.planning import toy

PLAN = np.array([[-1.0, 0.5, 1.0, 0.2, 0.3, 0.6], [0.1, 0.5, 0.1, 0.5, -0.6, 0.2]], np.float32)


def noting(net: Any, latent: Any, trace: Any, manipulation: Any) -> Any:
    """The toy world's step, with a trace that tells manipulations apart: it adds up where they grasped."""
    latent, _, shift = toy.step(net, latent, trace, manipulation)
    return latent, trace + manipulation[..., :1], shift


NOTING = toy.MODEL._replace(step=noting)


def test_expectations_are_those_of_the_plan_after_what_is_remembered() -> None:
    """Each common equivalent has a trace of its own; whatever the equivalent, predictions are in the state's labels."""
    states, common = np.stack([toy.bent(), toy.bent(3)]), np.array([5, 2])
    # Net a remembers k manipulations in equivalent k, net b twice as many, and both ten more in the second task.
    counts = np.array([np.arange(SQUARE.count), 2.0 * np.arange(SQUARE.count)])[:, None] + np.array([0, 10])[:, None]
    traces = tuple(np.repeat(count[..., None], 3072, axis=-1).astype(np.float32) for count in counts)
    plans = np.stack([PLAN, -PLAN])
    found = predict(NOTING, MESH, toy.NETS, states, traces, plans, common, np.tile(PAPERS_CLOTH, (2, 1)))
    for net, expected, count in zip(toy.NETS, found, counts, strict=True):
        assert expected.states.mean.shape == (2, 2, 32, 32, 3)
        for task in range(2):
            mesh, before = jnp.asarray(states[task]), count[task, common[task]]
            for i, manipulation in enumerate(plans[task]):
                mesh = toy.dragged(mesh, jnp.asarray(manipulation), net * (1 + 0.02 * before))
                before = before + float(relabel_manipulation(manipulation, int(common[task]))[0])
                np.testing.assert_allclose(expected.states.mean[task, i], mesh, atol=1e-5)
        # Only the first manipulation will be executed, in whichever equivalent the next plan is found.
        grasped = [[float(relabel_manipulation(plan[0], k)[0]) for k in range(SQUARE.count)] for plan in plans]
        np.testing.assert_allclose(expected.traces[..., 0], count + grasped, atol=1e-5)


def test_one_program_serves_all_nets_and_lengths() -> None:
    """A shorter plan's predictions are the first of a longer one's, bit for bit."""
    inputs = (NOTING, MESH, toy.NETS, toy.bent()[None], (np.ones((1, SQUARE.count, 3072), np.float32),) * 2)
    prediction._predict.clear_cache()
    longer, shorter = (predict(*inputs, PLAN[None, :length], np.array([3]), PAPERS_CLOTH[None]) for length in (2, 1))
    assert prediction._predict._cache_size() == 1
    for whole, part in zip(longer, shorter, strict=True):
        assert part.states.mean.shape == (1, 1, 32, 32, 3)
        np.testing.assert_array_equal(part.states.mean, whole.states.mean[:, :1])
        np.testing.assert_array_equal(part.shifts, whole.shifts[:, :1])


def test_differences_are_means_over_all_pairs_of_nets() -> None:
    """Of three nets, by hand: the mean of eq. (15)'s diff between nets 0 and 1, 0 and 2, 1 and 2."""
    state, plans = toy.bent()[None], PLAN[None]
    nets = tuple(jnp.float32(strength) for strength in (1.0, 1.1, 0.7))
    traces = tuple(np.zeros((1, SQUARE.count, 3072), np.float32) for _ in nets)
    found = predict(toy.MODEL, MESH, nets, state, traces, plans, np.array([0]), PAPERS_CLOTH[None])
    apart = differences(MESH, found)
    whitened = [whiten_probabilistic(of_net.states) for of_net in found]
    pairs = [
        np.mean((np.concatenate(a, axis=-1) - np.concatenate(b, axis=-1)) ** 2, axis=(-3, -2, -1))
        for a, b in ((whitened[0], whitened[1]), (whitened[0], whitened[2]), (whitened[1], whitened[2]))
    ]
    np.testing.assert_allclose(apart, np.mean(pairs, axis=0), rtol=1e-4)
    assert differences(MESH, found[:1]) is None
