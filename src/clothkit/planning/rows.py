"""What became of the sessions, as tidy rows: one per task (design section 4; sections 6.3, tables 6 and 7)."""

from functools import partial

import jax
import numpy as np
import pandas as pd
from jaxtyping import Array, Float, Int

from clothkit.cloth import voxels
from clothkit.cloth.equivalents import relabel_batch
from clothkit.cloth.grid import SIDE
from clothkit.cloth.layers import reversed_share
from clothkit.cloth.mesh import best_label, distance_aligned, error
from clothkit.planning.record import Sessions

_error = jax.jit(lambda mesh, truth: error(mesh, truth, aligned=True))
_unaligned = jax.jit(error)
_labelled = jax.jit(distance_aligned)
_relabelled = jax.jit(relabel_batch)
_best, _best_aligned = jax.jit(best_label), jax.jit(partial(best_label, aligned=True))
_differing = jax.jit(lambda a, b: (voxels.of_mesh(a) != voxels.of_mesh(b)).mean((-3, -2, -1)))


def rows(sessions: Sessions, system: str) -> pd.DataFrame:
    """What became of each task, and what its first plan was like. Errors in cloth lengths, aligned.

    Columns: split, system, sequence, start, length; error, error_labelled, error_no_action; voxel_error,
    voxel_error_no_action (mean voxel difference); layers_reversed (share of layers in another order than in the goal,
    `cloth.layers`); nulls (manipulations not executed), nulls_fired (of these cancelled by the null check), nulls_last
    (of these in a session's last step, where the check is about nothing but the outcome), nulls_helped (of nulls_last,
    how many would have ended farther from the goal); of the first plan: loss, loss_recorded (of the recorded
    manipulations), accuracy_a, accuracy_b, uncertainty (terms; with one net accuracy_a is its loss and accuracy_b is
    missing), expected (error that the nets expect), grasp_offered, estimate_error (not aligned), and
    estimate_layers_reversed. The estimate's and expected are missing for systems that see voxels.
    """
    task = np.arange(len(sessions))
    outcome, goal = sessions.state[task, sessions.length], sessions.goal
    steps = np.arange(sessions.null.shape[1])
    acted, last = steps < sessions.length[:, None], steps == sessions.length[:, None] - 1
    terms = sessions.terms[:, 0]
    fired = sessions.cancelled & acted
    # Where nothing was done the state stays as it is.
    staying = np.stack([np.asarray(_error(sessions.state[:, i], goal)) for i in range(acted.shape[1])], axis=1)
    meshes = sessions.estimate.shape[2:] == (SIDE, SIDE, 3)
    unknown = np.full(len(sessions), np.nan, np.float32)
    estimate, start = sessions.estimate[:, 0], sessions.state[:, 0]
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
            "layers_reversed": _layers_reversed(outcome, goal, _best_aligned(outcome, goal)),
            "nulls": (sessions.null & acted).sum(1),
            "nulls_fired": fired.sum(1),
            "nulls_last": (fired & last).sum(1),
            "nulls_helped": (fired & last & (sessions.error_otherwise > staying)).sum(1),
            "loss": sessions.loss[:, 0],
            "loss_recorded": sessions.loss_recorded,
            "accuracy_a": terms[:, 0],
            "accuracy_b": terms[:, 1],
            "uncertainty": terms[:, 2],
            "expected": sessions.expected[:, 0] if meshes else unknown,
            "grasp_offered": sessions.offered,
            "estimate_error": np.asarray(_unaligned(estimate, start)) if meshes else unknown,
            "estimate_layers_reversed": _layers_reversed(estimate, start, _best(estimate, start))
            if meshes
            else unknown,
        }
    )


def _layers_reversed(
    meshes: Float[np.ndarray, "task u v 3"], truths: Float[np.ndarray, "task u v 3"], labels: Int[Array, " task"]
) -> Float[np.ndarray, " task"]:
    """`reversed_share` of each, under the labels of the truth that fit best."""
    relabelled = np.asarray(_relabelled(truths, labels))
    return np.array([reversed_share(*pair) for pair in zip(meshes, relabelled, strict=True)], np.float32)


def voxel_error(
    outcome: Float[np.ndarray, "task u v 3"], goal: Float[np.ndarray, "task u v 3"]
) -> Float[np.ndarray, " task"]:
    """Mean absolute difference of voxel values; both meshes lie with their silhouettes' centres at (0, 0)."""
    return np.asarray(_differing(outcome, goal))
