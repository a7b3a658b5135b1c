"""Plans that are executed to their end without a look in between, as `clothkit simulate` executes plan files."""

import numpy as np
from jaxtyping import Float

from clothkit.cloth.silhouette import centred
from clothkit.episodes.sessions import Execute
from clothkit.manipulation.vector import is_null, is_single
from clothkit.planning.batches import take
from clothkit.planning.planner import Planner
from clothkit.planning.types import Meshes, Plan
from clothkit.runtime.errors import InputError
from clothkit.simulation.cloths import Cloths


def grasp_positions(
    planner: Planner, plan: Plan, centre: Float[np.ndarray, "task 2"]
) -> Float[np.ndarray, "task planned 2 2"]:
    """Where the hands grasp in each manipulation of a plan: xy on the table [normalised], NaN after the plan's end.

    The first grasp points lie on the planner's state, at the cloth's `centre` on the table; later ones lie on the best
    net's predicted means, where that net expects the cloth's centre.
    """
    states = np.concatenate([plan.state[:, None], plan.means[:, :-1, planner.best]], axis=1)
    shifts = np.cumsum(plan.shifts[:, :-1, planner.best], axis=1)
    centres = centre[:, None] + np.concatenate([np.zeros_like(shifts[:, :1]), shifts], axis=1)
    tasks, steps = plan.manipulations.shape[:2]
    grasps = plan.manipulations[..., :4].reshape(tasks * steps, 2, 2)
    flat = states.reshape(tasks * steps, *states.shape[2:])
    found = planner.representation.positions(np.nan_to_num(flat), np.nan_to_num(grasps))
    found = np.where(np.isnan(grasps), np.nan, found).reshape(tasks, steps, 2, 2)
    return (found + centres[:, :, None]).astype(np.float32)


def execute_plans(
    start: Meshes,
    centre: Float[np.ndarray, "task 2"],
    manipulations: Float[np.ndarray, "task planned 6"],
    positions: Float[np.ndarray, "task planned 2 2"],
    execute: Execute,
    cloths: Cloths,
) -> Meshes:
    """The outcomes of plans, centred; start states are true and centred, `positions` those of `grasp_positions`.

    Null manipulations are not executed; steps after a plan's end are NaN. Raises InputError if an outcome is not
    finite.
    """
    meshes = np.array(start, np.float32)
    meshes[..., :2] += centre[:, None, None]
    for step in range(manipulations.shape[1]):
        own = manipulations[:, step]
        acting = np.flatnonzero(np.isfinite(own).all(axis=1) & ~np.asarray(is_null(own)))
        if not len(acting):
            continue
        own = own[acting]
        single = np.asarray(is_single(own))
        outcomes = execute(meshes[acting], positions[acting, step], own[:, 4:], single, take(cloths, acting))
        if not np.isfinite(outcomes).all():
            raise InputError(f"simulation: manipulation {step} of a plan has an outcome that is not finite")
        meshes[acting] = outcomes
    return np.stack([centred(mesh)[0] for mesh in meshes])
