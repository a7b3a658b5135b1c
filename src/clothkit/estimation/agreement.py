"""Compares an estimated mesh with the observed voxels, to detect estimates that do not explain the observation."""

from functools import partial
from typing import Annotated, NamedTuple

import jax
import numpy as np
from annotated_types import Ge, Le
from jaxtyping import Bool, Float

from clothkit.cloth.voxels import VIEWPORT, Viewport, observe
from clothkit.runtime.config import config

Share = Annotated[float, Ge(0), Le(1)]

FORGIVEN = 1
"""Difference of two heights [voxels] that does not count: a surface near the border of two voxels may be seen in either
of them, and of a cloth that lies flat in one or two voxels that would be half of its height."""


@config
class AgreementConfig:
    """Thresholds of the agreement above which an estimate counts as explaining the observation.

    The defaults are for nets that come without their own (stage set_alarms); they were set for one of scale `laptop`.
    """

    silhouette: Share = 0.54
    """Least intersection over union of the columns that hold cloth."""
    heights: Share = 0.42
    """Least intersection over union of the occluded voxels, which include all voxels below the surface."""


class Agreement(NamedTuple):
    """Intersection over union between estimates and observations, 0..1."""

    silhouette: Float[np.ndarray, "*batch"]
    """That of the columns that hold cloth."""
    heights: Float[np.ndarray, "*batch"]
    """That of the occluded voxels: in each column, all voxels up to the height of the cloth. Where both hold cloth,
    heights that differ count as if they differed by `forgiven` less."""

    def explains(self, least: AgreementConfig) -> Bool[np.ndarray, "*batch"]:
        """Whether both values reach their thresholds."""
        return np.asarray((self.silhouette >= least.silhouette) & (self.heights >= least.heights))


def agreement(
    meshes: Float[np.ndarray, "*batch u v 3"],
    seen: Bool[np.ndarray, "*batch x y z"],
    *,
    viewport: Viewport = VIEWPORT,
    forgiven: int = FORGIVEN,
) -> Agreement:
    """The agreement of meshes [normalised, centred] with occluded, centred voxels of that viewport.

    The meshes are converted to voxels as for training, but without noise: doubled, occluded, and with points above the
    viewport clamped to its uppermost voxels.
    """
    shown = np.asarray(_observed(meshes, viewport=viewport))
    here, there = shown.sum(-1), np.asarray(seen).sum(-1)
    lower, higher = np.minimum(here, there), np.maximum(here, there)
    nearer = np.where(lower > 0, np.maximum(higher - forgiven, lower), higher)
    return Agreement(_ratio(lower > 0, higher > 0), _ratio(lower, nearer))


def _ratio(both: np.ndarray, either: np.ndarray) -> np.ndarray:
    """Intersection over union from those of each column; 1 where nothing is in either."""
    both, either = both.sum((-2, -1)), either.sum((-2, -1))
    return np.asarray(np.where(either > 0, both / np.maximum(either, 1), 1.0))


_observed = partial(jax.jit, static_argnames="viewport")(observe)
