"""Sessions: an agent and a world in turn, until each task's manipulations are used up (section 5.1, design 6.11)."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from clothkit.cloth.mesh import ProbabilisticMesh, error
from clothkit.cloth.silhouette import centred
from clothkit.episodes.record import Sessions, Step, Tasks, record, sizes_of
from clothkit.episodes.sensors import Sensor, exact_sensor
from clothkit.estimation.refine import refine
from clothkit.manipulation.vector import is_null, is_single
from clothkit.planning.agent import begin, decide
from clothkit.planning.batches import in_batches, take
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.lengths import LengthConfig
from clothkit.planning.planner import Planner
from clothkit.planning.plans import Keys
from clothkit.planning.types import Memory, Meshes, Observation, Plan
from clothkit.runtime.errors import InputError
from clothkit.simulation.cloths import Cloths

Execute = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Cloths], np.ndarray]
"""Executes manipulations: meshes [w u v 3], grasp points xy [w 2 2], displacements [w 2], whether one-handed [w], the
cloths -> resulting meshes [w u v 3]. Positions are relative to the table's origin [normalised], not to the cloth's
centre."""

REFINED_TOGETHER = 24
"""Number of predictions that are refined in one call."""

_error_aligned = jax.jit(partial(error, aligned=True))


def run_sessions(
    tasks: Tasks,
    planner: Planner,
    execute: Execute,
    *,
    sensor: Sensor | None = None,
    length: LengthConfig | None = None,
    trust: ErrorMap | None = None,
    refined: bool = True,
) -> Sessions:
    """Run the sessions of a batch of tasks in parallel, and return their record.

    With `length`, the agent chooses how many manipulations are worth it, as many as a task's length at most, and ends a
    session when nothing is, by what became of such plans, too, if `trust` tells it (`planning.agent.decide`). The
    record then repeats its last step, in which nothing was done.

    Without `refined`, predictions are not refined to meshes, which only figures of sessions show.

    At each step, the manipulations of all sessions are passed to `execute` in one call. Without a `sensor`, the planner
    observes exactly. Raises InputError if an outcome is not finite.
    """
    sensor = sensor or exact_sensor(planner.perception)
    lengths = np.array([task.length for task in tasks.task])
    goals = planner.representation.of_meshes(np.asarray(tasks.goal, np.float32))
    memory = begin(planner, goals, lengths, tasks.cloths.cloth)
    state, centre = np.asarray(tasks.start, np.float32), np.asarray(tasks.centre, np.float32)
    acting, steps = np.arange(len(lengths)), []
    observation, shift = sensor(state, None)
    for step in range(int(lengths.max())):
        # Sessions that are over leave the batch; `acting` has the rows of the others.
        kept = memory.left > 0
        if not kept.any():
            break
        acting, memory = acting[kept], take(memory, kept)
        state, centre, observation, shift = take((state, centre, observation, shift), kept)
        if step:
            observation, shift = _observed(sensor, state, memory, observation, shift)
        keys = search_keys(tasks, acting, step, planner.settings.seed)
        plan, memory = decide(planner, observation, memory, key=keys, length=length, trust=trust)
        state, centre, error_otherwise = _executed(
            plan,
            state,
            centre,
            shift,
            np.asarray(tasks.goal)[acting],
            take(tasks.cloths, acting),
            step,
            planner,
            execute,
        )
        plausible = _refined(planner, plan, memory.cloth) if refined else None
        steps.append(Step(acting, plan, plausible, state, centre, error_otherwise))
    return record(tasks, _to_the_end(steps, lengths), sizes_of(planner))


def _to_the_end(steps: list[Step], lengths: Int[np.ndarray, " task"]) -> list[Step]:
    """The steps of sessions, in which those that ended before their length repeat their last step.

    Nothing was done in that step, so that its state and its plan are those of all later ones.
    """
    whole = steps[:1]
    for number in range(1, int(lengths.max())):
        before = whole[-1]
        acting = steps[number].tasks if number < len(steps) else np.zeros(0, int)
        ended = (lengths[before.tasks] > number) & ~np.isin(before.tasks, acting)
        parts = steps[number : number + 1] + ([take(before, ended)] if ended.any() else [])
        whole.append(parts[0] if len(parts) == 1 else jax.tree.map(lambda *each: np.concatenate(each), *parts))
    return whole


def _observed(
    sensor: Sensor, state: Meshes, memory: Memory, before: Observation, shift: np.ndarray
) -> tuple[Observation, Float[np.ndarray, "task 2"]]:
    """Observations, and their shifts, of the cloths that were moved in the last step; the others keep theirs."""
    moved = np.flatnonzero(~memory.still)
    if not len(moved):
        return before, shift
    found = sensor(state[moved], memory.expected[moved])

    def merged(old: np.ndarray, new: np.ndarray) -> np.ndarray:
        values = old.copy()
        values[moved] = new
        return values

    return jax.tree.map(merged, (before, shift), tuple(found))


def search_keys(tasks: Tasks, acting: Int[np.ndarray, " acting"], step: int, seed: int) -> Keys:
    """A random key for each search. It depends on the seed, the task and the step only, not on the batch."""
    numbers = np.array([tasks.task[row][:3] for row in acting], np.uint32)
    return _folded(np.uint32(seed), *numbers.T, np.uint32(step))


@jax.jit
def _folded(seed: Any, sequence: Any, start: Any, length: Any, step: Any) -> jax.Array:
    def key(*parts: Any) -> jax.Array:
        key = jax.random.key(seed)
        for part in (*parts, step):
            key = jax.random.fold_in(key, part)
        return key

    return jax.vmap(key)(sequence, start, length)


def _refined(planner: Planner, plan: Plan, cloth: Float[np.ndarray, "task 3"]) -> Meshes | None:
    """The best net's predictions of the outcomes, refined to plausible meshes; None for voxels."""
    if plan.stds is None:
        return None
    last = (np.arange(len(plan.length)), plan.length - 1, planner.best)
    outcome = ProbabilisticMesh(plan.means[last], plan.stds[last])

    def refined(some: ProbabilisticMesh, cloth: np.ndarray) -> jax.Array:
        return refine(some, some.mean, planner.settings.refine, cloth=cloth)

    return in_batches(refined, REFINED_TOGETHER, outcome, cloth)


def _executed(
    plan: Plan,
    state: Meshes,
    centre: Float[np.ndarray, "task 2"],
    shift: Float[np.ndarray, "task 2"],
    goal: Meshes,
    cloths: Cloths,
    step: int,
    planner: Planner,
    execute: Execute,
) -> tuple[Meshes, Float[np.ndarray, "task 2"], Float[np.ndarray, " task"]]:
    """Execute the manipulations that are not null; returns true states and centres after them.

    Geodesic grasp points become Cartesian on the estimate, which is placed at the observed centre, the true one moved
    by `shift` (design 6.11).
    Manipulations that the null check cancelled are executed too, but only for their error to the goal, which is the
    third value (NaN for all others).
    """
    first = plan.manipulations[:, 0]
    state, centre, error_otherwise = state.copy(), centre.copy(), np.full(len(state), np.nan, np.float32)
    cancelled = plan.useless & ~np.asarray(is_null(first))
    tried = np.flatnonzero(~plan.null | cancelled)
    if not len(tried):
        return state, centre, error_otherwise
    meshes = state[tried]
    meshes[..., :2] += centre[tried, None, None]
    places = planner.representation.positions(plan.state[tried], first[tried, :4].reshape(-1, 2, 2))
    places = places + shift[tried, None]
    single = np.asarray(is_single(first[tried]))
    outcomes = execute(meshes, places + centre[tried, None], first[tried, 4:], single, take(cloths, tried))
    if not np.isfinite(outcomes).all():
        raise InputError(f"simulation: a manipulation of step {step} of a session has an outcome that is not finite")
    for task, outcome in zip(tried, outcomes, strict=True):
        after, middle = centred(outcome)
        if cancelled[task]:
            error_otherwise[task] = _error_aligned(after, goal[task], cloth=cloths.cloth[task])
        else:
            state[task], centre[task] = after, middle
    return state, centre, error_otherwise
