"""Sessions: observe, estimate, plan and execute, once per step (section 5.1, design 6.10, 6.11)."""

import contextlib
import dataclasses
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from clothkit.cloth.mesh import error
from clothkit.cloth.silhouette import centred
from clothkit.dataset.store import STEPS
from clothkit.episodes.diagnosis import note_recorded
from clothkit.episodes.record import Sessions, Tasks, blank
from clothkit.errors import InputError
from clothkit.manipulation.vector import is_null, is_single
from clothkit.planning.batches import in_batches
from clothkit.planning.draw import Candidates
from clothkit.planning.planner import Planner
from clothkit.planning.predict import Expected, expect
from clothkit.planning.search import UNKNOWN, Found, Problem

Execute = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Executes manipulations: meshes [w u v 3], grasp points xy [w 2 2], displacements [w 2], whether one-handed [w] ->
resulting meshes [w u v 3]. Positions are relative to the table's origin [normalised], not to the cloth's centre."""

Clock = dict[str, list[tuple[int, float]]]
"""Number of tasks and time [s] of each call, for searches of each plan length (`1`, `2`, `3`) and for `estimates`."""


@dataclasses.dataclass
class _Carried:
    """The state that a session keeps from one step to the next, in addition to its record."""

    expected: Float[np.ndarray, "task *state"]
    """The better net's predicted mean of the state after the last executed manipulation."""
    traces: tuple[Float[np.ndarray, "task labels latent"], ...]
    shift: Float[np.ndarray, "task 2"]
    """Vector from the true centre of the current state to the observed centre [normalised]."""


def run_sessions(tasks: Tasks, planner: Planner, execute: Execute) -> tuple[Sessions, Clock]:
    """Run the sessions of a batch of tasks in parallel; returns their record and the times of searches and estimates.

    At each step, the manipulations of all sessions are passed to `execute` in one call.
    """
    sessions, clock = blank(tasks, planner.sizes), defaultdict[str, list[tuple[int, float]]](list)
    goals = planner.sight.goals(sessions.goal)
    nowhere = np.zeros((len(sessions), 2), np.float32)
    carried = _Carried(np.zeros_like(sessions.estimate[:, 0]), no_traces(planner, len(sessions)), nowhere)
    for step in range(int(sessions.length.max())):
        acting = np.flatnonzero(sessions.length > step)
        _observe(sessions, carried, acting, step, planner, clock)
        for length in range(1, STEPS + 1):
            chosen = acting[sessions.length[acting] - step == length]
            if len(chosen):
                _plan(sessions, goals, carried, chosen, step, length, planner, clock)
        if step == 0 and tasks.recorded is not None:
            note_recorded(sessions, goals, tasks.recorded, planner)
        _act(sessions, carried, acting, step, planner, execute)
    return sessions, dict(clock)


@contextlib.contextmanager
def _timed(calls: list[tuple[int, float]], count: int) -> Iterator[None]:
    started = time.perf_counter()
    yield
    calls.append((count, time.perf_counter() - started))


def no_traces(planner: Planner, count: int) -> tuple[np.ndarray, ...]:
    """The initial memory traces t_0 for each net: zeros `[count, labels, latent]`."""
    forward = planner.sight.forward
    blank_state = jnp.zeros(planner.sight.shape)
    widths = [jax.eval_shape(forward.encode, net, blank_state).shape[-1] for net in planner.nets]
    return tuple(np.zeros((count, forward.labels, width), np.float32) for width in widths)


def _observe(
    sessions: Sessions, carried: _Carried, acting: np.ndarray, step: int, planner: Planner, clock: Clock
) -> None:
    """Write the estimates and candidates of the current states into `sessions`.

    Where the previous step executed no manipulation, those of the previous step are copied.
    """
    idle = acting[sessions.null[acting, step - 1]] if step else acting[:0]
    sessions.estimate[idle, step] = sessions.estimate[idle, step - 1]
    sessions.candidates[idle, step] = sessions.candidates[idle, step - 1]
    moved = np.setdiff1d(acting, idle)
    if not len(moved):
        return
    with _timed(clock["estimates"], len(moved)) if planner.system.estimates else contextlib.nullcontext():
        sessions.estimate[moved, step], carried.shift[moved] = planner.sight.see(
            sessions.state[moved, step], carried.expected[moved] if step else None
        )
    for task in moved:
        found = planner.sight.grasps(sessions.estimate[task, step], planner.grasping)
        sessions.candidates[task, step, : len(found)] = found


def _plan(
    sessions: Sessions,
    goals: np.ndarray,
    carried: _Carried,
    chosen: np.ndarray,
    step: int,
    length: int,
    planner: Planner,
    clock: Clock,
) -> None:
    """Search for plans, predict their outcomes, apply the null check (section 5.1), and write all into `sessions`."""
    problems = _problems(sessions, goals, carried, chosen, step, length, planner)
    find, batch = planner.finder(length), planner.settings.batch
    # The last batch is padded with copies, which are not counted as tasks.
    counts = iter([min(batch, len(chosen) - first) for first in range(0, len(chosen), batch)])

    def timed(problems: Problem, keys: jax.Array) -> Found:
        with _timed(clock[str(length)], next(counts)):
            return jax.block_until_ready(find(problems, keys))

    found: Found = in_batches(timed, batch, problems, _keys(sessions, chosen, step, planner.settings.seed))
    expected: tuple[Expected, ...] = in_batches(
        lambda *of: expect(planner.sight.forward, planner.nets, *of),
        batch,
        problems.state,
        problems.traces,
        found.plan,
        found.common,
    )
    means = [planner.sight.means(prediction.states) for prediction in expected]
    _note(sessions, chosen, step, length, found, expected, means)
    refined = planner.sight.refined(jax.tree.map(lambda part: part[:, -1], expected[planner.better].states))
    if refined is not None:
        sessions.refined[chosen, step] = refined
    wanted = planner.sight.relabelled(goals[chosen], np.asarray(found.relative))
    ends = planner.sight.misses(np.mean([mean[:, -1] for mean in means], axis=0), wanted)
    sessions.expected[chosen, step] = ends
    short = np.asarray(is_null(found.plan[:, 0]))
    useless = ends > planner.sight.misses(sessions.estimate[chosen, step], wanted)
    sessions.null[chosen, step] = useless | short
    sessions.cancelled[chosen, step] = useless & ~short
    _carry(sessions, carried, chosen, step, expected, means[planner.better])


def _problems(
    sessions: Sessions,
    goals: np.ndarray,
    carried: _Carried,
    chosen: np.ndarray,
    step: int,
    length: int,
    planner: Planner,
) -> Problem:
    points = sessions.candidates[chosen, step]
    count = np.isfinite(points[:, :, 0]).sum(1)
    if step:
        relative = sessions.relative[chosen, step - 1].astype(np.int32)
        rest = sessions.plan[chosen, step - 1, 1 : length + 1]
    else:
        relative = np.full(len(chosen), 0 if planner.sight.labelled else UNKNOWN, np.int32)
        rest = np.zeros((len(chosen), length, 6), np.float32)
    covered = None
    if planner.settings.search.fold:
        covered = np.stack([planner.sight.covered(state) for state in sessions.estimate[chosen, step]])
    return Problem(
        state=sessions.estimate[chosen, step],
        goal=goals[chosen],
        candidates=Candidates(np.nan_to_num(points), count),
        traces=tuple(trace[chosen] for trace in carried.traces),
        relative=relative,
        later=np.full(len(chosen), step > 0),
        carried=rest,
        covered=covered,
    )


def _keys(sessions: Sessions, chosen: np.ndarray, step: int, seed: int) -> jax.Array:
    """A random key for each search. It depends on the seed, the task and the step only, not on the batch."""

    numbers = (sessions.sequence[chosen], sessions.start[chosen], sessions.length[chosen])
    return _folded(np.uint32(seed), *(np.asarray(n, np.uint32) for n in numbers), np.uint32(step))


@jax.jit
def _folded(seed: Any, sequence: Any, start: Any, length: Any, step: Any) -> jax.Array:
    def key(*parts: Any) -> jax.Array:
        key = jax.random.key(seed)
        for part in (*parts, step):
            key = jax.random.fold_in(key, part)
        return key

    return jax.vmap(key)(sequence, start, length)


def _note(
    sessions: Sessions,
    chosen: np.ndarray,
    step: int,
    length: int,
    found: Found,
    expected: tuple[Expected, ...],
    means: list[np.ndarray],
) -> None:
    sessions.plan[chosen, step, :length] = found.plan
    sessions.loss[chosen, step] = found.loss
    sessions.terms[chosen, step, : len(expected)] = found.terms[:, :-1]
    sessions.terms[chosen, step, 2] = found.terms[:, -1]
    sessions.common[chosen, step] = found.common
    sessions.relative[chosen, step] = found.relative
    for net, (prediction, mean) in enumerate(zip(expected, means, strict=True)):
        sessions.prediction_mean[chosen, step, :length, net] = mean
        if sessions.prediction_std.size:
            sessions.prediction_std[chosen, step, :length, net] = prediction.states.std
    iterations = found.losses.shape[1]
    progress = np.minimum.accumulate(found.losses.min(-1), axis=1)
    sessions.progress[chosen, step, :iterations] = progress
    sessions.restarts[chosen, step] = best_of_restarts(
        np.asarray(found.losses), np.asarray(found.restarts), sessions.restarts.shape[-1]
    )


def best_of_restarts(
    losses: Float[np.ndarray, "task iteration strain"], restarts: np.ndarray, most: int
) -> Float[np.ndarray, "task strain restart"]:
    """The lowest loss of each strain between consecutive restarts.

    Periods after number `most` are merged into it. NaN where a period does not exist or has no finite loss.
    """
    run = np.minimum(np.cumsum(restarts, axis=1) - restarts, most - 1)
    found = [np.where(run == number, losses, np.inf).min(1) for number in range(most)]
    best = np.stack(found, axis=-1).astype(np.float32)
    return np.where(np.isinf(best), np.nan, best).astype(np.float32)


def _carry(
    sessions: Sessions,
    carried: _Carried,
    chosen: Int[np.ndarray, " chosen"],
    step: int,
    expected: tuple[Expected, ...],
    means: Float[np.ndarray, "chosen n *state"],
) -> None:
    """Keep the predicted next state and memory traces of the sessions whose manipulation will be executed."""
    done = ~sessions.null[chosen, step]
    carried.expected[chosen[done]] = means[done, 0]
    for trace, prediction in zip(carried.traces, expected, strict=True):
        trace[chosen[done]] = prediction.traces[done]


def _act(
    sessions: Sessions, carried: _Carried, acting: np.ndarray, step: int, planner: Planner, execute: Execute
) -> None:
    """Execute the manipulations that are not null, and write the resulting states into `sessions`.

    Geodesic grasp points become Cartesian on the estimate, which is placed at the observed centre (design 6.11).
    Manipulations that the null check cancelled are executed too, but only to compute `error_otherwise`.
    """
    idle = acting[sessions.null[acting, step]]
    sessions.state[idle, step + 1] = sessions.state[idle, step]
    sessions.centre[idle, step + 1] = sessions.centre[idle, step]
    tried = acting[~sessions.null[acting, step] | sessions.cancelled[acting, step]]
    if not len(tried):
        return
    centre = sessions.centre[tried, step]
    meshes = sessions.state[tried, step].copy()
    meshes[..., :2] += centre[:, None, None]
    manipulation = sessions.plan[tried, step, 0]
    places = planner.sight.places(sessions.estimate[tried, step], manipulation[:, :4].reshape(-1, 2, 2))
    places = places + carried.shift[tried, None]
    outcomes = execute(meshes, places + centre[:, None], manipulation[:, 4:], np.asarray(is_single(manipulation)))
    if not np.isfinite(outcomes).all():
        raise InputError(f"simulation: a manipulation of step {step} of a session has an outcome that is not finite")
    for task, outcome in zip(tried, outcomes, strict=True):
        state, middle = centred(outcome)
        if sessions.cancelled[task, step]:
            sessions.error_otherwise[task, step] = error(state, sessions.goal[task], aligned=True)
        else:
            sessions.state[task, step + 1], sessions.centre[task, step + 1] = state, middle
