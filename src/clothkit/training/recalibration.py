"""Recalibration of VtM's standard deviations, after training, on the validation split.

Estimates combine several views, whose errors average out while their standard deviations do not, and training holds up
the weight of uncertain coordinates: stated deviations are too large where the net is sure. So they are mapped by
factor x sigma^power, such that the median of each state's sigma ratio is that of a normal distribution (Kuleshov et
al., "Accurate uncertainties for deep learning using calibrated regression", ICML 2018, with two parameters).
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize

from clothkit.cloth.mesh import Cloth, ProbabilisticMesh, best_label
from clothkit.cloth.symmetry import relabel_batch
from clothkit.dataset.store import STATES, Dataset
from clothkit.models import vtm
from clothkit.models.net import Net

IDEAL = float(np.sqrt(2 / np.pi))
"""The mean of abs(error) / sigma of a normal distribution."""

BATCH = 20


def recalibrated(net: Net, validation: Dataset) -> Net:
    """Return the net with the factor and power that make its sigma true on the validation split."""
    row, state = np.nonzero((np.arange(STATES) <= validation.length[:, None]) & (np.arange(STATES) > 0))
    estimate = jax.jit(_estimate)
    parts = []
    for first in range(0, len(row), BATCH):
        # The last batch is padded, so that one program serves all.
        chosen = np.minimum(np.arange(first, first + BATCH), len(row) - 1)
        found = estimate(net, validation.vertices[row[chosen], state[chosen]], validation.cloth[row[chosen]])
        parts.append([np.asarray(part)[: len(row) - first] for part in found])
    error, std = (np.concatenate(part) for part in zip(*parts, strict=True))
    factor, power = fit(error, std, state)
    config = dataclasses.replace(net.config, sigma_factor=factor, sigma_power=power)
    return Net(config, net.params)


def _estimate(net: Net, truth: Float[np.ndarray, "batch u v 3"], cloth: Cloth) -> ProbabilisticMesh:
    """Return the absolute errors of the net's means, and its standard deviations."""
    found = vtm.estimate(net, vtm.seen_by(net, truth), cloth)
    nearest = relabel_batch(truth, best_label(found.mean, truth, cloth=cloth))
    return ProbabilisticMesh(jnp.abs(jnp.asarray(found.mean) - nearest), found.std)


def fit(
    error: Float[np.ndarray, "meshes u v 3"], std: Float[np.ndarray, "meshes u v 3"], state: Int[np.ndarray, " meshes"]
) -> tuple[float, float]:
    """Return the factor and the power with which the median sigma ratio of each state's meshes is nearest to ideal.

    `error` are absolute errors, `state` the groups of meshes whose ratios count alike.
    """
    logarithm, groups = np.log(std), [np.flatnonzero(state == k) for k in np.unique(state)]

    def unlike(parameters: Float[np.ndarray, "2"]) -> float:
        ratio = np.mean(error / np.exp(parameters[0] + parameters[1] * logarithm), axis=(1, 2, 3))
        return float(sum(np.log(np.median(ratio[rows]) / IDEAL) ** 2 for rows in groups))

    found = minimize(unlike, np.array([0.0, 1.0]), method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-6}).x
    return round(float(np.exp(found[0])), 4), round(float(found[1]), 4)
