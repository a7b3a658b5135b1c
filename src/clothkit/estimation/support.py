"""Support: how strange an observation is, compared with those that a net learned from.

The units of an early hidden layer describe an observation. Their mean and covariance over training examples give the
Mahalanobis distance of a new one (Lee et al., "A simple unified framework for detecting out-of-distribution samples",
NeurIPS 2018, without classes). Later layers keep less of what the training examples never showed.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

LEAST_VARIANCE = 1e-3
"""Added to the variance along each principal axis, as a share of their mean."""


class Support(NamedTuple):
    """The distribution of a layer's units over training examples."""

    mean: Float[np.ndarray, " units"]
    whitening: Float[np.ndarray, "units units"]
    """Maps differences from the mean to uncorrelated numbers of variance one."""


def fit(units: Float[np.ndarray, "examples units"]) -> Support:
    """The support of the units of training examples."""
    units = np.asarray(units, float)
    variance, axes = np.linalg.eigh(np.cov(units.T))
    scale = 1 / np.sqrt(np.maximum(variance, 0) + LEAST_VARIANCE * variance.mean())
    return Support(units.mean(axis=0).astype(np.float32), (axes * scale).astype(np.float32))


def strangeness(units: Float[np.ndarray, "*batch units"], support: Support) -> Float[np.ndarray, "*batch"]:
    """The root mean square of the whitened units: about 1 for training examples."""
    return np.asarray(np.sqrt(np.mean(((np.asarray(units) - support.mean) @ support.whitening) ** 2, axis=-1)))
