"""What became of the sessions, as tidy rows: one per task (design section 4; sections 6.3, tables 6 and 7)."""

import jax
import numpy as np
import pandas as pd
from jaxtyping import Float

from clothkit.cloth import voxels
from clothkit.cloth.grid import SIDE
from clothkit.cloth.mesh import distance_aligned, error
from clothkit.planning.record import Sessions

_error = jax.jit(lambda mesh, truth: error(mesh, truth, aligned=True))
_unaligned = jax.jit(error)
_labelled = jax.jit(distance_aligned)
_differing = jax.jit(lambda a, b: (voxels.of_mesh(a) != voxels.of_mesh(b)).mean((-3, -2, -1)))


def rows(sessions: Sessions, system: str) -> pd.DataFrame:
    """What became of each task, and what its first plan was like. Errors in cloth lengths, aligned.

    Columns: split, system, sequence, start, length; error, error_labelled, error_no_action; voxel_error,
    voxel_error_no_action (mean voxel difference); nulls (manipulations not executed), nulls_fired (of these cancelled
    by the null check), nulls_helped (of these, how many would have ended farther from the goal); of the first plan:
    loss, loss_recorded (of the recorded manipulations), accuracy_a, accuracy_b, uncertainty (terms; with one net
    accuracy_a is its loss and accuracy_b is missing), expected (error that the nets expect), grasp_offered, and
    estimate_error (not aligned). expected and estimate_error are missing for systems that see voxels.
    """
    task = np.arange(len(sessions))
    outcome, goal = sessions.state[task, sessions.length], sessions.goal
    acted = np.arange(sessions.null.shape[1]) < sessions.length[:, None]
    terms = sessions.terms[:, 0]
    fired = sessions.cancelled & acted
    # Where nothing was done the state stays as it is.
    staying = np.stack([np.asarray(_error(sessions.state[:, i], goal)) for i in range(acted.shape[1])], axis=1)
    meshes = sessions.estimate.shape[2:] == (SIDE, SIDE, 3)
    unknown = np.full(len(sessions), np.nan, np.float32)
    return pd.DataFrame(
        {
            "split": sessions.split.astype(object),
            "system": system,
            "sequence": sessions.sequence,
            "start": sessions.start.astype(np.int64),
            "length": sessions.length.astype(np.int64),
            "error": np.asarray(_error(outcome, goal)),
            "error_labelled": np.asarray(_labelled(outcome, goal)),
            "error_no_action": staying[:, 0],
            "voxel_error": voxel_error(outcome, goal),
            "voxel_error_no_action": voxel_error(sessions.state[:, 0], goal),
            "nulls": (sessions.null & acted).sum(1),
            "nulls_fired": fired.sum(1),
            "nulls_helped": (fired & (sessions.error_otherwise > staying)).sum(1),
            "loss": sessions.loss[:, 0],
            "loss_recorded": sessions.loss_recorded,
            "accuracy_a": terms[:, 0],
            "accuracy_b": terms[:, 1],
            "uncertainty": terms[:, 2],
            "expected": sessions.expected[:, 0] if meshes else unknown,
            "grasp_offered": sessions.offered,
            "estimate_error": np.asarray(_unaligned(sessions.estimate[:, 0], sessions.state[:, 0]))
            if meshes
            else unknown,
        }
    )


def voxel_error(
    outcome: Float[np.ndarray, "task u v 3"], goal: Float[np.ndarray, "task u v 3"]
) -> Float[np.ndarray, " task"]:
    """Mean absolute difference of voxel values; both meshes lie with their silhouettes' centres at (0, 0)."""
    return np.asarray(_differing(outcome, goal))
