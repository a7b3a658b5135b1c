"""Errors and sigma ratios on constructed cases."""

import jax
import numpy as np
import pytest

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.symmetry import relabel, relabel_batch
from clothkit.cloth.topology import SQUARE, rectangle
from clothkit.evaluation.errors import (
    errors,
    labelled_errors,
    labels_of_truth,
    relabelled,
    sigma_ratio,
)


def crumpled(seed: int) -> np.ndarray:
    """A mesh without any symmetry."""
    noise = np.random.default_rng(seed).normal(size=(32, 32, 3)).astype(np.float32)
    return SQUARE.flat() + 0.1 * noise


@pytest.mark.parametrize("k", range(SQUARE.count))
def test_error_is_the_smallest_over_the_equivalents(k: int) -> None:
    truth = crumpled(0)[None]
    moved = truth + np.array([0.03, 0, 0.04], np.float32)
    estimate = np.asarray(relabel(moved, k))
    assert np.asarray(errors(estimate, truth)) == pytest.approx(0.05 / 1.4, abs=1e-6)
    assert np.asarray(errors(estimate, truth, aligned=True)) == pytest.approx(0, abs=1e-6)
    by_hand = np.linalg.norm(estimate - truth, axis=-1).mean() / 1.4
    assert np.asarray(labelled_errors(estimate, truth)) == pytest.approx(by_hand, abs=1e-6)


def test_labels_lead_back_to_the_truth() -> None:
    truth = np.stack([crumpled(seed) for seed in range(SQUARE.count)])
    estimate = relabel_batch(truth, np.arange(SQUARE.count))
    k = labels_of_truth(estimate, truth)
    np.testing.assert_array_equal(relabelled(np.asarray(estimate), k), truth)


def test_sigma_ratio_of_a_perfectly_calibrated_prediction() -> None:
    rng = np.random.default_rng(0)
    mean = np.stack([crumpled(seed) for seed in range(16)])
    std = rng.uniform(0.01, 0.05, mean.shape).astype(np.float32)
    truth = (mean + std * rng.normal(size=mean.shape)).astype(np.float32)
    labels = np.arange(16) % SQUARE.count
    predicted = ProbabilisticMesh(relabel_batch(mean, labels), relabel_batch(std, labels))
    ratio = np.asarray(jax.device_get(sigma_ratio(predicted, truth)))
    assert ratio.mean() == pytest.approx(0.798, abs=0.004)


def test_a_rectangle_is_compared_under_its_four_labellings_only() -> None:
    topology = rectangle(1.8)
    truth = np.stack([crumpled(seed) for seed in range(topology.count)])
    estimate = np.asarray(relabel_batch(truth, np.arange(topology.count), topology))
    np.testing.assert_array_equal(np.asarray(errors(estimate, truth, topology=topology)), 0)
    k = labels_of_truth(estimate, truth, topology)
    np.testing.assert_array_equal(relabelled(estimate, k, topology=topology), truth)
    spread = ProbabilisticMesh(estimate, np.full_like(estimate, 0.01))
    np.testing.assert_array_equal(sigma_ratio(spread, truth, topology), 0)
    swapped = truth.swapaxes(1, 2)
    np.testing.assert_array_equal(np.asarray(errors(swapped, truth)), 0)
    assert (np.asarray(errors(swapped, truth, topology=topology)) > 0.1).all()
