"""Voxel errors of sessions in the viewport that is twice as high, for a second table 7."""

import jax
import numpy as np
import pandas as pd
from jaxtyping import Array

from clothkit.cloth import voxels
from clothkit.episodes.record import Sessions
from clothkit.evaluation.comparisons import KEYS
from clothkit.evaluation.occupancy import TALL, TALL_MEASURE, differences


@jax.jit
def _differing(one: Array, other: Array) -> Array:
    return differences(voxels.of_mesh(one, viewport=TALL), voxels.of_mesh(other, viewport=TALL))


def rows(sessions: Sessions, system: str) -> pd.DataFrame:
    """Return a row per task, in addition to the rows of the plan stages.

    The columns are split, system, sequence, start, length, voxel_error_025 and voxel_error_025_no_action [mean voxel
    difference]. As for `voxel_error`, the voxels are undoubled, unoccluded and free of noise.
    """
    outcome = sessions.state[np.arange(len(sessions)), sessions.length]
    return pd.DataFrame(
        {
            "split": sessions.split.astype(object),
            "system": system,
            **{name: getattr(sessions, name).astype(np.int64) for name in KEYS},
            TALL_MEASURE: np.asarray(_differing(outcome, sessions.goal)),
            f"{TALL_MEASURE}_no_action": np.asarray(_differing(sessions.state[:, 0], sessions.goal)),
        }
    )
