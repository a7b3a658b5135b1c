"""Alarms: observations that the nets do not know, and estimates that do not explain what was seen, are noticed."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from clothkit.cloth.topology import SQUARE
from clothkit.estimation.agreement import Agreement, AgreementConfig, agreement
from clothkit.estimation.support import Support, strangeness
from clothkit.models.net import Net
from clothkit.models.vtm import hidden_units
from clothkit.runtime.errors import InputError, system_error
from clothkit.simulation.settings import LEAST_SPACING

_QUANTILES = 41

BATCH = 64
"""So many observations are shown to a net at a time."""

MARGIN = 1.5
"""Factor by which a cloth's thickness, and its shorter side, may be beyond those that the net learned from."""


class Signs(NamedTuple):
    """What tells of a batch of observations and their estimates whether they can be relied on."""

    agreement: Agreement
    strangeness: Float[np.ndarray, " batch"]


def signs(
    net: Net,
    support: Support,
    voxels: Bool[np.ndarray, "batch x y z"],
    mesh: Float[np.ndarray, "batch u v 3"],
    cloth: Float[np.ndarray, "batch 3"],
) -> Signs:
    """The signs of observed voxels and the refined meshes that are estimated from them."""
    units = [_units(net, voxels[i : i + BATCH], cloth[i : i + BATCH]) for i in range(0, len(voxels), BATCH)]
    agrees = agreement(mesh, voxels, viewport=net.config.viewport)
    return Signs(agrees, strangeness(np.concatenate([np.asarray(part) for part in units]), support))


class Alarms(NamedTuple):
    """Thresholds from which an alarm is raised, and the net's support."""

    least: AgreementConfig
    """Less agreement of estimate and observation than this is an alarm."""
    strangest: float
    """More strangeness than this is an alarm."""
    support: Support
    cloths: Float[np.ndarray, "2 3"]
    """The smallest and the largest sides and thickness [normalised] of the cloths that the net learned from."""

    def knows(self, cloth: Float[np.ndarray, "*batch 3"]) -> Bool[np.ndarray, "*batch"]:
        """Whether a cloth's sides and thickness are about those of a cloth that the net learned from."""
        # The order of the sides is not told to nets that know squares, and does not matter to others.
        sides, low = np.sort(cloth[..., :2], axis=-1), self.cloths[0]
        of_ratio = sides[..., 0] >= min(low[:2]) / MARGIN
        return np.asarray(of_ratio & (cloth[..., 2] >= low[2] / MARGIN) & (cloth[..., 2] <= self.thickest(cloth)))

    def thickest(self, cloth: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
        """The thickest cloth with such sides that the net knows [normalised].

        The simulator's grid allows a thickness of no more than the distance of vertices over LEAST_SPACING, so narrow
        cloths of the data are thinner than its thickest squares.
        """
        spacing = np.min(cloth[..., :2], axis=-1) / (SQUARE.shape[0] - 1)
        return np.asarray(MARGIN * np.minimum(self.cloths[1, 2], spacing / LEAST_SPACING))

    def raised(self, signs: Signs) -> Bool[np.ndarray, " batch"]:
        """Whether an alarm is raised."""
        return ~signs.agreement.explains(self.least) | (signs.strangeness > self.strangest)


def chosen(known: Sequence[Signs], support: Support, cloths: Float[np.ndarray, "2 3"], *, share: float) -> Alarms:
    """The strictest thresholds at which at most a share of each batch in `known` raises an alarm.

    `known` are signs of states like those that the net was trained on. All three thresholds are the same quantile of
    the batches, the most lenient one of them; thresholds of agreement are rounded down to a hundredth.
    """
    best = Alarms(AgreementConfig(silhouette=0.0, heights=0.0), np.inf, support, cloths)
    for quantile in np.linspace(0, share, _QUANTILES):
        silhouette, heights = (
            min(float(np.floor(100 * np.quantile(signs.agreement[i], quantile)) / 100) for signs in known)
            for i in range(2)
        )
        strangest = max(float(np.quantile(signs.strangeness, 1 - quantile)) for signs in known)
        tried = Alarms(AgreementConfig(silhouette=silhouette, heights=heights), strangest, support, cloths)
        if all(tried.raised(signs).mean() <= share for signs in known):
            best = tried
    return best


def save(path: Path, alarms: Alarms) -> None:
    """Write alarms as NPZ. Equal alarms give equal bytes."""
    thresholds = np.array([alarms.least.silhouette, alarms.least.heights, alarms.strangest])
    with path.open("wb") as file:
        np.savez(file, thresholds=thresholds, cloths=alarms.cloths, **alarms.support._asdict())


def load(path: Path, *, units: int) -> Alarms:
    """Read the alarms of a net whose layer has so many units. Raises InputError if they are damaged or of another."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            names = ("thresholds", "cloths", "mean", "whitening")
            thresholds, cloths, mean, whitening = (np.asarray(arrays[name]) for name in names)
    except OSError as error:
        raise system_error(error, path, expected="thresholds of alarms") from error
    except Exception as error:  # NumPy raises many types of exceptions for damaged files
        raise InputError(f"{path}: expected thresholds of alarms, found a truncated or damaged file") from error
    shapes = (thresholds.shape, cloths.shape, mean.shape, whitening.shape)
    if shapes != ((3,), (2, 3), (units,), (units, units)):
        raise InputError(
            f"{path}: expected alarms for a net of {units} units, found those of {mean.size}; run dvc repro"
        )
    if not all(np.isfinite(part).all() for part in (thresholds, cloths, mean, whitening)):
        raise InputError(f"{path}: expected finite numbers, found NaN or infinity")
    try:
        least = AgreementConfig(silhouette=float(thresholds[0]), heights=float(thresholds[1]))
    except ValueError as error:
        raise InputError(f"{path}: expected thresholds from 0 to 1, found {thresholds[:2]}") from error
    return Alarms(least, float(thresholds[2]), Support(mean, whitening), cloths)


_units = jax.jit(hidden_units)
