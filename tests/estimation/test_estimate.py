"""Estimates take the labels of the prediction that they are refined from (design 6.10)."""

from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.symmetry import equivalents, relabel
from clothkit.cloth.topology import SQUARE, rectangle
from clothkit.estimation import estimate as module
from clothkit.estimation.estimate import alternatives, estimate, estimate_unrefined, fused, labelled_like
from clothkit.estimation.refine import RefineConfig
from clothkit.models.hypotheses import Hypotheses
from clothkit.models.net import Net
from clothkit.models.vtm import VtMConfig, initial, seen_by


def lopsided() -> np.ndarray:
    """A mesh whose eight equivalents all differ."""
    mesh = SQUARE.flat().copy()
    mesh[20:, :10, 2] = 0.05
    mesh[..., 0] *= 0.8
    return mesh


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 7))
def test_labels_follow_the_prediction(k: int) -> None:
    mesh = lopsided()[None]
    blurred = ProbabilisticMesh(*(np.asarray(relabel(part, k)) for part in (mesh, np.full(mesh.shape, 0.02, "f4"))))
    near = mesh + np.random.default_rng(0).normal(0, 0.01, mesh.shape).astype(np.float32)
    np.testing.assert_allclose(labelled_like(blurred, near).mean, mesh, atol=1e-6)


def test_estimates_of_a_small_net() -> None:
    config = VtMConfig(hidden=4)
    net = Net(config, initial(config, key=jax.random.key(0)))
    seen = np.zeros((2, 32, 32, 16), bool)
    seen[:, 8:24, 8:24, 0] = True
    refining = RefineConfig(iterations=5)
    plain = estimate(net, seen, refining)
    assert plain.mesh.shape == plain.probabilistic.mean.shape == (2, 32, 32, 3)
    # Refinement starts at VtM's means, and moves every coordinate by a step at a time: of each coarse grid, and of the
    # mesh itself.
    furthest = 5 * refining.step * (sum(level.stride for level in refining.coarse) + 1)
    moved = np.abs(plain.mesh - plain.probabilistic.mean)
    assert 0 < moved.max() <= furthest + 1e-6
    np.testing.assert_array_equal(estimate_unrefined(net, seen), plain.probabilistic.mean)
    guess = np.repeat(lopsided()[None], 2, axis=0)
    predicted = ProbabilisticMesh(guess, np.full_like(guess, 0.01))
    biased = estimate(net, seen, RefineConfig(iterations=5, prior=None), predicted=predicted)
    assert 0 < np.abs(biased.mesh - guess).max() <= furthest + 1e-6
    # Under the labels of what was predicted, refined or not.
    np.testing.assert_array_equal(biased.probabilistic.mean, labelled_like(plain.probabilistic, guess).mean)
    np.testing.assert_array_equal(estimate_unrefined(net, seen, guess), biased.probabilistic.mean)
    # What is sure of the prediction counts, what is not does not.
    half = predicted._replace(std=np.where(np.arange(3) < 2, 1e-6, np.inf).astype(np.float32) * np.ones_like(guess))
    mixed = estimate(net, seen, RefineConfig(iterations=5, prior=2.0), predicted=half)
    np.testing.assert_allclose(mixed.probabilistic.mean[..., :2], guess[..., :2], atol=1e-5)
    np.testing.assert_allclose(mixed.probabilistic.mean[..., 2], biased.probabilistic.mean[..., 2], atol=1e-6)


def test_a_surer_source_counts_more() -> None:
    """By hand: 1 with a deviation of 1, and 4 with one of 2, are 1.6 with one of the square root of 0.8."""
    one, other = (
        ProbabilisticMesh(jnp.full((1, 2, 2, 3), m), jnp.full((1, 2, 2, 3), s)) for m, s in ((1, 1.0), (4, 2.0))
    )
    found = fused(one, other)
    np.testing.assert_allclose(found.mean, 1.6, rtol=1e-6)
    np.testing.assert_allclose(found.std, np.sqrt(0.8), rtol=1e-6)
    alone = fused(one, other._replace(std=jnp.full((1, 2, 2, 3), jnp.inf)))
    np.testing.assert_array_equal(alone.mean, one.mean)
    np.testing.assert_array_equal(alone.std, one.std)


def test_labels_are_among_the_cloths_own_symmetries() -> None:
    topology = rectangle(1.5)
    mesh = (topology.flat() + np.float32([0, 0, 0.1]) * np.random.default_rng(1).random((32, 32, 1), np.float32))[None]
    std = np.full(mesh.shape, 0.02, np.float32)
    for k in range(topology.count):
        blurred = ProbabilisticMesh(np.asarray(relabel(mesh, k, topology)), std)
        np.testing.assert_allclose(labelled_like(blurred, mesh, topology).mean, mesh, atol=1e-6)
    swapped = ProbabilisticMesh(mesh.swapaxes(1, 2), std)
    found = np.asarray(labelled_like(swapped, mesh, topology).mean)
    assert not any(np.allclose(found, np.asarray(m), atol=1e-3) for m in np.asarray(equivalents(mesh, topology)))


def quarter(mirrored: bool) -> np.ndarray:
    """A cloth of which a quarter is folded over at one side, or at the other."""
    mesh = SQUARE.flat().copy()
    over = mesh[..., 0] > 0.35
    mesh[..., 0] = np.where(over, 0.7 - mesh[..., 0], mesh[..., 0])
    mesh[..., 2] = np.where(over, 0.02, 0.0)
    return mesh * np.float32([-1, 1, 1]) if mirrored else mesh


def two_shapes(*_: object) -> Hypotheses:
    """What a net answers that takes two shapes for about as probable, for one observation."""
    mean = jnp.asarray(np.stack([quarter(False), quarter(True)])[None])
    return Hypotheses(ProbabilisticMesh(mean, jnp.full(mean.shape, 0.01)), jnp.array([[0.6, 0.4]]))


def test_a_shape_that_explains_the_voxels_gains_probability() -> None:
    config = VtMConfig(hidden=4, hypotheses=2)
    net = Net(config, initial(config, key=jax.random.key(0)))
    with mock.patch.object(module, "_vtm", two_shapes):
        for mirrored in (False, True):
            seen = np.asarray(seen_by(net, quarter(mirrored)[None]))
            found, mesh = alternatives(net, seen, RefineConfig(iterations=0))
            assert found.probability[0, 0] > 0.9
            assert float(jnp.sum(found.probability)) == pytest.approx(1, abs=1e-6)
            np.testing.assert_allclose(mesh[0, 0], quarter(mirrored), atol=1e-6)
            np.testing.assert_allclose(found.mesh.mean[0], mesh[0], atol=1e-6)
            np.testing.assert_array_equal(estimate(net, seen, RefineConfig(iterations=0)).mesh[0], mesh[0, 0])
            # Without doubt, it is the net's word alone.
            first = alternatives(net, seen, RefineConfig(iterations=0, doubt=0.0)).mesh[0, 0]
            np.testing.assert_allclose(first, quarter(False), atol=1e-6)


def test_a_prediction_chooses_among_the_shapes() -> None:
    config = VtMConfig(hidden=4, hypotheses=2)
    net = Net(config, initial(config, key=jax.random.key(0)))
    seen = np.asarray(seen_by(net, quarter(False)[None]))
    with mock.patch.object(module, "_vtm", two_shapes):
        for mirrored in (False, True):
            expected = np.asarray(relabel(quarter(mirrored), 3))[None]
            predicted = ProbabilisticMesh(expected, np.full_like(expected, 0.02))
            found = estimate(net, seen, RefineConfig(iterations=0), predicted=predicted)
            np.testing.assert_allclose(found.probabilistic.mean, expected, atol=1e-6)
