"""The results of sessions as tidy rows, one per task (design section 4; section 6.3, tables 6 and 7)."""

import jax
import numpy as np
import pandas as pd
from jaxtyping import Array, Float, Int

from clothkit.cloth import voxels
from clothkit.cloth.layers import reversed_share
from clothkit.cloth.mesh import best_label, distance_aligned, error
from clothkit.cloth.symmetry import relabel_batch
from clothkit.cloth.topology import SQUARE
from clothkit.episodes.record import Sessions

_error = jax.jit(lambda mesh, truth, cloth: error(mesh, truth, aligned=True, cloth=cloth))
_unaligned = jax.jit(lambda mesh, truth, cloth: error(mesh, truth, cloth=cloth))
_labelled = jax.jit(distance_aligned)
_relabelled = jax.jit(relabel_batch)
_best = jax.jit(lambda mesh, truth, cloth: best_label(mesh, truth, cloth=cloth))
_best_aligned = jax.jit(lambda mesh, truth, cloth: best_label(mesh, truth, aligned=True, cloth=cloth))
_differing = jax.jit(lambda a, b: (voxels.of_mesh(a) != voxels.of_mesh(b)).mean((-3, -2, -1)))


def rows(sessions: Sessions, system: str) -> pd.DataFrame:
    """The outcome of each task and the properties of its first plan, one row per task.

    Errors are in cloth lengths and aligned, unless stated otherwise. Columns:

    - split, system, sequence, start, length.
    - error, error_labelled, error_no_action; voxel_error, voxel_error_no_action (mean voxel difference).
    - layers_reversed: share of overlapping vertex pairs whose order differs from the goal's (`cloth.layers`).
    - nulls: manipulations not executed; nulls_fired: those of nulls that the null check cancelled; nulls_last: those of
      nulls_fired in the session's last step, where the manipulation's outcome is the session's outcome; nulls_helped:
      those of nulls_last after which the state would have been farther from the goal.
    - Of the first plan: loss; loss_recorded (loss of the recorded manipulations); accuracy_0, accuracy_1, .., one for
      each of the system's nets, and uncertainty (terms of the loss; a single net's accuracy_0 is the loss); expected
      (predicted error); grasp_offered.
    - Of the first estimate: estimate_error (not aligned), estimate_layers_reversed.

    The columns of the estimate and expected are NaN for systems that plan in voxels.
    """
    task = np.arange(len(sessions))
    outcome, goal, cloth = sessions.state[task, sessions.length], sessions.goal, sessions.cloth
    steps = np.arange(sessions.null.shape[1])
    acted, last = steps < sessions.length[:, None], steps == sessions.length[:, None] - 1
    terms = sessions.terms[:, 0]
    fired = sessions.cancelled & acted
    # A step that is not executed leaves its state unchanged, so this is its error.
    staying = np.stack([np.asarray(_error(sessions.state[:, i], goal, cloth)) for i in range(acted.shape[1])], axis=1)
    meshes = sessions.estimate.shape[2:] == (*SQUARE.shape, 3)
    unknown = np.full(len(sessions), np.nan, np.float32)
    estimate, start = sessions.estimate[:, 0], sessions.state[:, 0]
    return pd.DataFrame(
        {
            "split": sessions.split.astype(object),
            "system": system,
            "sequence": sessions.sequence,
            "start": sessions.start.astype(np.int64),
            "length": sessions.length.astype(np.int64),
            "error": np.asarray(_error(outcome, goal, cloth)),
            "error_labelled": np.asarray(_labelled(outcome, goal)),
            "error_no_action": staying[:, 0],
            "voxel_error": voxel_error(outcome, goal),
            "voxel_error_no_action": voxel_error(sessions.state[:, 0], goal),
            "layers_reversed": _layers_reversed(outcome, goal, _best_aligned(outcome, goal, cloth)),
            "nulls": (sessions.null & acted).sum(1),
            "nulls_fired": fired.sum(1),
            "nulls_last": (fired & last).sum(1),
            "nulls_helped": (fired & last & (sessions.error_otherwise > staying)).sum(1),
            "loss": sessions.loss[:, 0],
            "loss_recorded": sessions.loss_recorded,
            **{f"accuracy_{net}": terms[:, net] for net in range(terms.shape[1] - 1)},
            "uncertainty": terms[:, -1],
            "expected": sessions.expected[:, 0] if meshes else unknown,
            "grasp_offered": sessions.offered,
            "estimate_error": np.asarray(_unaligned(estimate, start, cloth)) if meshes else unknown,
            "estimate_layers_reversed": _layers_reversed(estimate, start, _best(estimate, start, cloth))
            if meshes
            else unknown,
        }
    )


def _layers_reversed(
    meshes: Float[np.ndarray, "task u v 3"], truths: Float[np.ndarray, "task u v 3"], labels: Int[Array, " task"]
) -> Float[np.ndarray, " task"]:
    """`reversed_share` of each mesh, after relabelling the true mesh by `labels`."""
    relabelled = np.asarray(_relabelled(truths, labels))
    return np.array([reversed_share(*pair) for pair in zip(meshes, relabelled, strict=True)], np.float32)


def voxel_error(
    outcome: Float[np.ndarray, "task u v 3"], goal: Float[np.ndarray, "task u v 3"]
) -> Float[np.ndarray, " task"]:
    """Mean absolute difference of voxel values, `[task]`. Both meshes must have their silhouette's centre at (0, 0)."""
    return np.asarray(_differing(outcome, goal))
