"""What sessions came to in voxels of the viewport that is twice as high: table 7 for it."""

import jax
import numpy as np
import pandas as pd
from jaxtyping import Array

from clothkit.cloth import voxels
from clothkit.evaluation.comparisons import KEYS
from clothkit.evaluation.occupancy import TALL, TALL_MEASURE, differences
from clothkit.planning.record import Sessions


@jax.jit
def _differing(one: Array, other: Array) -> Array:
    return differences(voxels.of_mesh(one, height=TALL), voxels.of_mesh(other, height=TALL))


def rows(sessions: Sessions, system: str) -> pd.DataFrame:
    """A row per task, beside those of the plan stages: undoubled, unoccluded and free of noise, as `voxel_error` is.

    split, system, sequence, start, length, voxel_error_025, voxel_error_025_no_action [mean voxel difference].
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
