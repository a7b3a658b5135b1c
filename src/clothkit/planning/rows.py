"""What became of the sessions, as tidy rows: one per task (design section 4; sections 6.3, tables 6 and 7)."""

import jax
import numpy as np
import pandas as pd
from jaxtyping import Float

from clothkit.cloth import voxels
from clothkit.cloth.mesh import distance_aligned, error
from clothkit.planning.record import Sessions

_error = jax.jit(lambda mesh, truth: error(mesh, truth, aligned=True))


def rows(sessions: Sessions, system: str) -> pd.DataFrame:
    """Errors of outcomes and of no action [cloth length, aligned], voxel error, nulls, and the first plan's loss terms.

    Columns: split, system, sequence, start, length, error, error_labelled, error_no_action, voxel_error, nulls, loss,
    accuracy_a, accuracy_b, uncertainty. With one net accuracy_a is its NLL and accuracy_b is missing.
    """
    every = np.arange(len(sessions))
    outcome, goal = sessions.state[every, sessions.length], sessions.goal
    acted = np.arange(sessions.null.shape[1]) < sessions.length[:, None]
    terms = sessions.terms[:, 0]
    return pd.DataFrame(
        {
            "split": sessions.split.astype(object),
            "system": system,
            "sequence": sessions.sequence,
            "start": sessions.start.astype(np.int64),
            "length": sessions.length.astype(np.int64),
            "error": np.asarray(_error(outcome, goal)),
            "error_labelled": np.asarray(distance_aligned(outcome, goal)),
            "error_no_action": np.asarray(_error(sessions.state[:, 0], goal)),
            "voxel_error": voxel_error(outcome, goal),
            "nulls": (sessions.null & acted).sum(1),
            "loss": sessions.loss[:, 0],
            "accuracy_a": terms[:, 0],
            "accuracy_b": terms[:, 1],
            "uncertainty": terms[:, 2],
        }
    )


def voxel_error(
    outcome: Float[np.ndarray, "task u v 3"], goal: Float[np.ndarray, "task u v 3"]
) -> Float[np.ndarray, " task"]:
    """Mean absolute difference of voxel values; both meshes lie with their silhouettes' centres at (0, 0)."""
    differing = voxels.of_mesh(outcome) != voxels.of_mesh(goal)
    return np.asarray(differing.mean((-3, -2, -1)))
