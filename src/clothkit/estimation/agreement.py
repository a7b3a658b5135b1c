"""Whether an estimated mesh explains what was seen: both as columns of voxels, held against one another."""

from collections.abc import Sequence
from functools import partial
from typing import Annotated, NamedTuple

import jax
import numpy as np
from annotated_types import Ge, Le
from jaxtyping import Bool, Float

from clothkit.cloth.voxels import HEIGHT, observe
from clothkit.config import config

_QUANTILES = 41

Share = Annotated[float, Ge(0), Le(1)]


@config
class AgreementConfig:
    """From which agreement on an estimate is said to explain what was seen.

    Provisional: low enough for few false alarms, but guessed. studies/agreement.py proposes values, such that at most
    2 % of the validation split's states raise an alarm; it was not run yet with a trained net.
    """

    silhouette: Share = 0.5
    """Least intersection over union of the columns that hold cloth."""
    heights: Share = 0.2
    """Least intersection over union of the occluded voxels: of what lies below the surface."""


class Agreement(NamedTuple):
    """Intersection over union of an estimate and what was seen, 0..1; an array each for a batch."""

    silhouette: Float[np.ndarray, "*batch"]
    """Of the columns that hold cloth."""
    heights: Float[np.ndarray, "*batch"]
    """Of the occluded voxels, a column of which is as high as the cloth there."""

    def explains(self, least: AgreementConfig) -> Bool[np.ndarray, "*batch"]:
        """Whether both are high enough."""
        return np.asarray((self.silhouette >= least.silhouette) & (self.heights >= least.heights))


def agreement(
    meshes: Float[np.ndarray, "*batch u v 3"], seen: Bool[np.ndarray, "*batch x y z"], *, height: float = HEIGHT
) -> Agreement:
    """How far meshes [normalised, centred] agree with occluded, centred voxels of a viewport of that height.

    The meshes are looked at as training looks at them: doubled, occluded, what is higher than the viewport clamped.
    """
    shown = np.asarray(_observed(meshes, height=height))
    columns = np.asarray(shown.any(-1)), np.asarray(seen.any(-1))
    return Agreement(_iou(*columns, axes=2), _iou(shown, seen, axes=3))


def proposed(known: Sequence[Agreement], *, alarms: float) -> AgreementConfig:
    """The highest thresholds that warn of at most a share `alarms` of each batch of states that a net knows.

    Both stand at the same quantile of one of the batches, rounded down to a hundredth.
    """
    found = [AgreementConfig(silhouette=0.0, heights=0.0)]
    for batch in known:
        for quantile in np.linspace(0, alarms, _QUANTILES):
            least = (float(np.floor(100 * np.quantile(values, quantile)) / 100) for values in batch)
            tried = AgreementConfig(silhouette=next(least), heights=next(least))
            if all((~other.explains(tried)).mean() <= alarms for other in known):
                found.append(tried)
    return max(found, key=lambda config: config.silhouette + config.heights)


def _iou(a: np.ndarray, b: np.ndarray, *, axes: int) -> np.ndarray:
    over = tuple(range(-axes, 0))
    both, either = (a & b).sum(over), (a | b).sum(over)
    return np.asarray(np.where(either > 0, both / np.maximum(either, 1), 1.0))


_observed = partial(jax.jit, static_argnames="height")(observe)
