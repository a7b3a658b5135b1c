"""Sessions: observe, estimate, plan, execute, again until the length is used up (section 5.1, design 6.10, 6.11)."""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from clothkit.cloth import voxels
from clothkit.cloth.equivalents import COUNT, relabel_batch
from clothkit.cloth.grid import SIDE
from clothkit.cloth.mesh import ProbabilisticMesh, distance_aligned
from clothkit.cloth.silhouette import centred
from clothkit.dataset.store import STEPS
from clothkit.errors import InputError
from clothkit.estimation.estimate import estimate
from clothkit.estimation.refine import refine
from clothkit.manipulation.candidates import CandidateConfig, candidates
from clothkit.manipulation.geometry import to_cartesian, to_geodesic
from clothkit.manipulation.vector import is_null, is_single
from clothkit.networks.net import Net
from clothkit.planning.batches import in_batches
from clothkit.planning.draw import Candidates
from clothkit.planning.forward import MESH, Forward
from clothkit.planning.loss import Weights
from clothkit.planning.normalisation import Normalisation
from clothkit.planning.predict import Expected, expect
from clothkit.planning.record import Sessions, Sizes, Tasks, blank
from clothkit.planning.search import UNKNOWN, Found, Problem, search
from clothkit.planning.settings import PlanConfig
from clothkit.planning.systems import System

Execute = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Meshes [w u v 3], grasp points [w 2 2], displacements [w 2], single [w] -> outcomes [w u v 3]; where they lie on the
table, normalised."""

CORNERS = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]], np.float32)
"""The cloth's own corners: candidates of a mesh that shows none."""

OBSERVED_TOGETHER = 24
"""Voxel grids that are estimated as one program."""


@dataclasses.dataclass(frozen=True)
class Planner:
    """A system with all that it plans with."""

    system: System
    nets: tuple[Any, ...]
    better: int
    """Which of the nets has the better validation score."""
    vtm: Net | None
    """Not asked where the true mesh is seen."""
    normalisation: Normalisation
    weights: Weights
    settings: PlanConfig
    grasping: CandidateConfig
    forward: Forward = MESH

    @property
    def sizes(self) -> Sizes:
        """What sizes a session's record has."""
        found, longest = self.settings.search, self.settings.search.iterations(STEPS)
        return Sizes(self.grasping.most, len(self.nets), longest, found.strains, longest // found.patience + 1)


@dataclasses.dataclass
class _Carried:
    """What goes from one step of a session to the next, besides its record."""

    expected: Float[np.ndarray, "task u v 3"]
    """The better net's mean for the state after the manipulation that was executed."""
    traces: tuple[Float[np.ndarray, "task 8 latent"], ...]


def run_sessions(tasks: Tasks, planner: Planner, execute: Execute) -> Sessions:
    """The sessions of a batch of tasks, side by side; manipulations of all of them are executed together."""
    sessions = blank(tasks, planner.sizes)
    carried = _Carried(np.zeros_like(sessions.goal), _no_traces(planner, len(sessions)))
    for step in range(int(sessions.length.max())):
        acting = np.flatnonzero(sessions.length > step)
        _observe(sessions, carried, acting, step, planner)
        for length in range(1, STEPS + 1):
            chosen = acting[sessions.length[acting] - step == length]
            if len(chosen):
                _plan(sessions, carried, chosen, step, length, planner)
        _act(sessions, acting, step, execute)
    return sessions


def _no_traces(planner: Planner, count: int) -> tuple[np.ndarray, ...]:
    """t_0, the zero vector, for every task and common equivalent."""
    flat = jnp.zeros((SIDE, SIDE, 3))
    widths = [jax.eval_shape(planner.forward.encode, net, flat).shape[-1] for net in planner.nets]
    return tuple(np.zeros((count, COUNT, width), np.float32) for width in widths)


def _observe(sessions: Sessions, carried: _Carried, acting: np.ndarray, step: int, planner: Planner) -> None:
    """Estimates and candidates of the current states; where nothing was done, those of the step before."""
    idle = acting[sessions.null[acting, step - 1]] if step else acting[:0]
    sessions.estimate[idle, step] = sessions.estimate[idle, step - 1]
    sessions.candidates[idle, step] = sessions.candidates[idle, step - 1]
    moved = np.setdiff1d(acting, idle)
    if not len(moved):
        return
    truth = sessions.state[moved, step]
    expected = carried.expected[moved] if step else None
    sessions.estimate[moved, step] = truth if planner.system.true_meshes else _estimates(truth, expected, planner)
    for task in moved:
        found = candidate_points(sessions.estimate[task, step], planner.grasping)
        sessions.candidates[task, step, : len(found)] = found


def _estimates(truth: np.ndarray, expected: np.ndarray | None, planner: Planner) -> np.ndarray:
    """Refined meshes of what a camera sees of the true meshes."""
    assert planner.vtm is not None
    vtm, settings = planner.vtm, planner.settings.refine
    seen = np.asarray(voxels.observe(truth))
    if expected is None:
        return in_batches(lambda seen: estimate(vtm, seen, settings).mesh, OBSERVED_TOGETHER, seen)
    return in_batches(
        lambda seen, expected: estimate(vtm, seen, settings, predicted=expected).mesh,
        OBSERVED_TOGETHER,
        seen,
        expected,
    )


def candidate_points(mesh: Float[np.ndarray, "u v 3"], settings: CandidateConfig) -> Float[np.ndarray, "candidates 2"]:
    """Geodesic grasp points of a mesh (section 4.3); the cloth's corners if its silhouette shows none."""
    xy = candidates(mesh, settings)
    uv = to_geodesic(mesh, xy) if len(xy) else CORNERS
    distinct = np.sort(np.unique(uv, axis=0, return_index=True)[1])
    return uv[distinct][: settings.most].astype(np.float32)


def _plan(sessions: Sessions, carried: _Carried, chosen: np.ndarray, step: int, length: int, planner: Planner) -> None:
    """Search, ask the nets what they expect, and check whether that is better than doing nothing."""
    problems = _problems(sessions, carried, chosen, step, length, planner)
    keys = _keys(sessions, chosen, step, planner.settings.seed)
    find = partial(
        search,
        planner.forward,
        length=length,
        settings=planner.settings.search,
        explicit=float(planner.weights.alpha) > 0,
    )
    reference = planner.normalisation.reference(length)
    batch = planner.settings.batch
    found: Found = in_batches(
        lambda problems, keys: find(planner.nets, problems, reference, planner.weights, keys=keys),
        batch,
        problems,
        keys,
    )
    expected: tuple[Expected, ...] = in_batches(
        lambda *of: expect(planner.forward, planner.nets, *of),
        batch,
        problems.mesh,
        problems.traces,
        found.plan,
        found.common,
    )
    _note(sessions, chosen, step, length, found, expected)
    outcome = ProbabilisticMesh(*(part[:, -1] for part in expected[planner.better].states))
    refined = in_batches(
        lambda outcome: refine(outcome, outcome.mean, planner.settings.refine), OBSERVED_TOGETHER, outcome
    )
    sessions.refined[chosen, step] = refined
    goal = np.asarray(relabel_batch(sessions.goal[chosen], found.relative))
    useless = _useless(expected, sessions.estimate[chosen, step], goal)
    sessions.null[chosen, step] = useless | np.asarray(is_null(found.plan[:, 0]))
    _carry(sessions, carried, chosen, step, planner.better, expected)


def _problems(
    sessions: Sessions, carried: _Carried, chosen: np.ndarray, step: int, length: int, planner: Planner
) -> Problem:
    points = sessions.candidates[chosen, step]
    count = np.isfinite(points[:, :, 0]).sum(1)
    if step:
        relative = sessions.relative[chosen, step - 1].astype(np.int32)
        rest = sessions.plan[chosen, step - 1, 1 : length + 1]
    else:
        known = planner.system.true_meshes
        relative = np.full(len(chosen), 0 if known else UNKNOWN, np.int32)
        rest = np.zeros((len(chosen), length, 6), np.float32)
    return Problem(
        mesh=sessions.estimate[chosen, step],
        goal=sessions.goal[chosen],
        candidates=Candidates(np.nan_to_num(points), count),
        traces=tuple(trace[chosen] for trace in carried.traces),
        relative=relative,
        later=np.full(len(chosen), step > 0),
        carried=rest,
    )


def _keys(sessions: Sessions, chosen: np.ndarray, step: int, seed: int) -> jax.Array:
    """A key for each search, from what it is about and nothing else."""

    def key(sequence: Any, start: Any, length: Any) -> Any:
        key = jax.random.key(seed)
        for part in (sequence, start, length, step):
            key = jax.random.fold_in(key, part)
        return key

    numbers = (sessions.sequence[chosen], sessions.start[chosen], sessions.length[chosen])
    return jax.vmap(key)(*(np.asarray(n, np.uint32) for n in numbers))


def _note(
    sessions: Sessions, chosen: np.ndarray, step: int, length: int, found: Found, expected: tuple[Expected, ...]
) -> None:
    sessions.plan[chosen, step, :length] = found.plan
    sessions.loss[chosen, step] = found.loss
    sessions.terms[chosen, step, : len(expected)] = found.terms[:, :-1]
    sessions.terms[chosen, step, 2] = found.terms[:, -1]
    sessions.common[chosen, step] = found.common
    sessions.relative[chosen, step] = found.relative
    for net, prediction in enumerate(expected):
        sessions.prediction_mean[chosen, step, :length, net] = prediction.states.mean
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
    """The lowest loss of each strain from one restart to the next; NaN for restarts that never came."""
    run = np.cumsum(restarts, axis=1) - restarts
    found = [np.where(run == number, losses, np.inf).min(1) for number in range(most)]
    best = np.stack(found, axis=-1).astype(np.float32)
    return np.where(np.isinf(best), np.nan, best).astype(np.float32)


def _useless(
    expected: tuple[Expected, ...], current: Float[np.ndarray, "task u v 3"], goal: Float[np.ndarray, "task u v 3"]
) -> np.ndarray:
    """The null check: whether the nets expect the plan to end farther from the goal than the cloth is now."""
    outcome = np.mean([prediction.states.mean[:, -1] for prediction in expected], axis=0)
    return np.asarray(distance_aligned(outcome, goal) > distance_aligned(current, goal))


def _carry(
    sessions: Sessions,
    carried: _Carried,
    chosen: Int[np.ndarray, " chosen"],
    step: int,
    better: int,
    expected: tuple[Expected, ...],
) -> None:
    """Keep the expected next state and the memory traces of what will be executed."""
    done = ~sessions.null[chosen, step]
    carried.expected[chosen[done]] = expected[better].states.mean[done, 0]
    for trace, prediction in zip(carried.traces, expected, strict=True):
        trace[chosen[done]] = prediction.traces[done]


def _act(sessions: Sessions, acting: np.ndarray, step: int, execute: Execute) -> None:
    """Execute what is not null: grasp points go through the estimate to where the silhouette was observed."""
    null = sessions.null[acting, step]
    idle, moving = acting[null], acting[~null]
    sessions.state[idle, step + 1] = sessions.state[idle, step]
    sessions.centre[idle, step + 1] = sessions.centre[idle, step]
    if not len(moving):
        return
    centre = sessions.centre[moving, step]
    meshes = sessions.state[moving, step].copy()
    meshes[..., :2] += centre[:, None, None]
    manipulation = sessions.plan[moving, step, 0]
    uv = manipulation[:, :4].reshape(-1, 2, 2)
    believed = np.repeat(sessions.estimate[moving, step][:, None], 2, axis=1)
    grasps = np.asarray(to_cartesian(believed, uv))[..., :2] + centre[:, None]
    outcomes = execute(meshes, grasps, manipulation[:, 4:], np.asarray(is_single(manipulation)))
    if not np.isfinite(outcomes).all():
        raise InputError(f"simulation: a manipulation of step {step} of a session has an outcome that is not finite")
    for task, outcome in zip(moving, outcomes, strict=True):
        sessions.state[task, step + 1], sessions.centre[task, step + 1] = centred(outcome)
