"""One plan from one observation: a step of a session (section 5.1) for a cloth whose true state is not known."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray, Shaped

from clothkit.app.given import Seen, Settings, Taken
from clothkit.cloth.equivalents import compose, inverse, relabel, relabel_manipulation
from clothkit.cloth.mesh import best_label, distance
from clothkit.episodes.session import no_traces
from clothkit.errors import InputError
from clothkit.estimation.estimate import Estimate, estimate, estimate_unrefined
from clothkit.manipulation.turns import turn_manipulation, turn_mesh
from clothkit.models import store
from clothkit.models.net import Net
from clothkit.planning.draw import Candidates
from clothkit.planning.forward import Forward
from clothkit.planning.loss import uncertainty
from clothkit.planning.planner import Planner, artifacts, assemble
from clothkit.planning.predict import expect
from clothkit.planning.search import UNKNOWN, Found, Problem
from clothkit.planning.systems import System

Traces = tuple[Float[np.ndarray, "labels latent"], ...]
Believed = Shaped[np.ndarray, "*state"]
"""A state as a system represents it: a mesh [u v 3], normalised and centred, or voxels [x y z]."""


class Past(NamedTuple):
    """What the next search needs of an earlier plan whose first manipulation was executed (section 5.1)."""

    expected: Believed
    """The better net's mean prediction of the current state."""
    traces: Traces
    relative: int
    rest: Float[np.ndarray, "n 6"]
    """The manipulations of the earlier plan after its first."""


class Planned(NamedTuple):
    """A plan and the nets' predictions for it, in the labels of the state."""

    state: Believed
    plan: Float[np.ndarray, "n 6"]
    common: int
    """The Cartesian equivalent in which the plan was found, 0..7 (0 for voxels)."""
    relative: int
    """The relabelling that brings the goal under the state's labels."""
    predictions: tuple[Any, ...]
    """Each net's predicted states after each manipulation."""
    shifts: Float[np.ndarray, "n 2"]
    """Shift of the cloth's centre by each manipulation, as the better net predicts it [normalised]."""
    traces: Traces
    """Each net's memory traces before the plan."""
    loss: float = np.nan


def planner_of(system: System, data: Path, settings: Settings) -> Planner:
    """Load the planner of a system with its nets. Raises InputError that names a missing or broken artifact."""
    found = artifacts(system, data)
    for name, path in found.items():
        if not path.exists():
            raise InputError(f"{path}: not found, system {system.name} plans with it; dvc repro makes it")
        if name != "reference":
            store.description(path)
    return assemble(system, data, settings.weights, settings.plan, settings.grasping)


def vtm_of(data: Path, settings: Settings) -> Net:
    """Load VtM, the net that estimates meshes from voxels.

    Raises InputError if it is missing or broken, or if its voxels have another height than `app.cloud.height`.
    """
    path = data / "nets/vtm"
    if not path.exists():
        raise InputError(f"{path}: not found, it sees meshes in voxels; dvc repro makes it")
    vtm, height = store.load(path, "vtm"), settings.app.cloud.height
    if height != vtm.config.height:
        raise InputError(f"app.cloud.height: is {height}, but {path} knows voxels up to {vtm.config.height}")
    return vtm


def estimated(vtm: Net, seen: Seen, settings: Settings, *, expected: Believed | None = None) -> Estimate:
    """Estimate the mesh of one cloth, as a batch of one; labels and refinement follow `expected`, if that is given."""
    predicted = None if expected is None else expected[None].astype(np.float32)
    return estimate(vtm, seen.observation.voxels[None], settings.plan.refine, predicted=predicted)


def believed(
    system: System, seen: Seen, data: Path, settings: Settings, *, expected: Believed | None = None
) -> Believed:
    """Return the state that the system plans from: voxels, the file's mesh, or an estimate.

    A mesh has the labels of `expected`, if that is given. Raises InputError when the system needs a mesh and the file
    holds none.
    """
    if system.voxels:
        return seen.observation.voxels
    if system.true_meshes:
        mesh = mesh_of(seen)
        if mesh is None:
            raise InputError(
                f"{seen.file}: holds {seen.kind}, but system {system.name} plans from a mesh [32, 32, 3]; "
                "system main estimates it"
            )
        return mesh if expected is None else like(mesh, expected)
    vtm = vtm_of(data, settings)
    if not system.refine:
        predicted = None if expected is None else expected[None].astype(np.float32)
        return np.asarray(estimate_unrefined(vtm, seen.observation.voxels[None], predicted)[0])
    return np.asarray(estimated(vtm, seen, settings, expected=expected).mesh[0])


def goal_of(system: System, seen: Seen, data: Path, settings: Settings) -> Believed:
    """Return a goal in the system's representation: voxels, the file's mesh, or an estimate if there is no mesh."""
    if system.voxels:
        return seen.observation.voxels
    mesh = mesh_of(seen)
    return np.asarray(estimated(vtm_of(data, settings), seen, settings).mesh[0]) if mesh is None else mesh


def taken(system: System, seen: Seen, *, goal: bool = False) -> Taken:
    """Return whether a system plans from (or for) a file's content as it is, or an estimate of it."""
    as_it_is = system.voxels or (mesh_of(seen) is not None and (goal or system.true_meshes))
    return "as it is" if as_it_is else "estimated"


def mesh_of(seen: Seen) -> Float[np.ndarray, "u v 3"] | None:
    """The mesh that a file holds [normalised, centred], None if it holds anything else."""
    return getattr(seen.state, "mesh", None)


def like(mesh: Float[np.ndarray, "u v 3"], expected: Float[np.ndarray, "u v 3"]) -> Float[np.ndarray, "u v 3"]:
    """Return the Cartesian equivalent of a mesh that is nearest to `expected`."""
    return np.asarray(relabel(mesh, best_label(expected.astype(np.float32), mesh, aligned=True)))


def find_plan(
    planner: Planner, state: Believed, goal: Believed, length: int, *, seed: int, past: Past | None = None
) -> Planned:
    """Search for a plan of `length` manipulations, and return the best one.

    For every system the goal may have any labels: it is reached when any of its equivalents is. Raises InputError when
    the nets have no reference values for plans of that length.
    """
    problem = problem_of(planner, state, goal, length, past=past)
    found = find(planner.finder(length), problem, jax.random.key(seed))
    return planned_of(planner, problem, found)


def problem_of(planner: Planner, state: Believed, goal: Believed, length: int, *, past: Past | None = None) -> Problem:
    """Build a search's input. Raises InputError when the nets have no reference values for plans of that length."""
    planner.normalisation.reference(length)
    grasps = planner.sight.grasps(state, planner.grasping)
    points = np.zeros((planner.grasping.most, 2), np.float32)
    points[: len(grasps)] = grasps
    voxels, traces = planner.system.voxels, past.traces if past else first_traces(planner)
    return Problem(
        state=state,
        goal=goal,
        candidates=Candidates(points, len(grasps)),
        traces=traces,
        relative=np.array(past.relative if past else 0 if voxels else UNKNOWN, np.int32),
        later=np.array(past is not None),
        carried=past.rest if past else np.zeros((length, 6), np.float32),
        covered=planner.sight.covered(state) if planner.settings.search.fold else None,
    )


def find(finder: Callable[[Problem, jax.Array], Found], problem: Problem, key: PRNGKeyArray) -> Found:
    """Run one search, and return its result as NumPy arrays."""
    problems = jax.tree.map(lambda leaf: np.asarray(leaf)[None], problem)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[0], finder(problems, key.reshape(1)))


def planned_of(planner: Planner, problem: Problem, found: Found) -> Planned:
    """Return the plan that a search found, with the nets' predictions for it."""
    traces = tuple(np.asarray(trace) for trace in problem.traces)
    planned = predicted(
        planner, np.asarray(problem.state), np.asarray(found.plan), common=int(found.common), traces=traces
    )
    return planned._replace(relative=int(found.relative), loss=float(found.loss))


def first_traces(planner: Planner) -> Traces:
    """Return the memory traces at the start of a session, t_0, one array per net."""
    return tuple(trace[0] for trace in no_traces(planner, 1))


def predicted(
    planner: Planner, state: Believed, plan: Float[np.ndarray, "n 6"], *, common: int, traces: Traces
) -> Planned:
    """Predict the states after each manipulation of a plan; the result's `relative` is 0 and its `loss` NaN."""
    forward, k = planner.sight.forward, np.array([common])
    each = tuple(trace[None] for trace in traces)
    expected = expect(forward, planner.nets, state[None], each, plan[None], k)
    states = tuple(jax.tree.map(lambda leaf: np.asarray(leaf)[0], of_net.states) for of_net in expected)
    shifts = _centre_shifts(forward, planner.nets[planner.better], state, traces[planner.better], plan, k[0])
    return Planned(state, plan, common, 0, states, np.asarray(shifts), tuple(traces))


def traces_after(planner: Planner, planned: Planned) -> Traces:
    """Return each net's memory traces after the first manipulation of a plan."""
    each = tuple(trace[None] for trace in planned.traces)
    common = np.array([planned.common])
    expected = expect(planner.sight.forward, planner.nets, planned.state[None], each, planned.plan[None], common)
    return tuple(np.asarray(of_net.traces[0]) for of_net in expected)


@partial(jax.jit, static_argnames="forward")
def _centre_shifts(
    forward: Forward,
    net: Any,
    state: Shaped[Array, "*state"],
    traces: Float[Array, "labels latent"],
    plan: Float[Array, "n 6"],
    common: Int[Array, ""],
) -> Float[Array, "n 2"]:
    latent, trace = forward.encode(net, forward.equivalents(state))[common], traces[common]
    shifts = []
    for manipulation in relabel_manipulation(plan, common):
        latent, trace, shift = forward.step(net, latent, trace, manipulation)
        shifts.append(shift)
    return jnp.stack(shifts)


def disagreement(planner: Planner, planned: Planned) -> float | None:
    """Return u of eq. (15), the epistemic uncertainty of a plan; None if there is only one net."""
    if len(planner.nets) == 1:
        return None
    differences = planner.sight.forward.diff(*jax.tree.map(jnp.asarray, planned.predictions))
    spread = planner.normalisation.reference(len(planned.plan)).spread
    return float(uncertainty(differences, spread, beta=planner.weights.beta, gamma=planner.weights.gamma))


def turned_plan(planner: Planner, planned: Planned, matrix: Float[np.ndarray, "2 2"]) -> Planned:
    """Return the plan turned or mirrored by `matrix`, a symmetry of the state; its goal is `turned_goal`.

    The state keeps its place and its labels, and only the manipulations turn. The nets' predictions are computed again
    for the turned plan; the loss is that of the original.
    """
    turn = jnp.asarray(matrix, jnp.float32)
    turns = jnp.broadcast_to(turn, (len(planned.plan), 2, 2))
    turned = turn_mesh(jnp.asarray(planned.state), turn)
    k = int(jnp.argmin(jnp.stack([distance(turned, relabel(planned.state, k)) for k in range(8)])))
    plan = relabel_manipulation(turn_manipulation(jnp.asarray(planned.plan), turns), inverse(k))
    common = compose(k, planned.common)
    found = predicted(planner, planned.state, np.asarray(plan), common=common, traces=planned.traces)
    return found._replace(relative=compose(planned.relative, inverse(k)), loss=planned.loss)


def turned_goal(goal: Believed, matrix: Float[np.ndarray, "2 2"]) -> Believed:
    """Return a goal mesh turned or mirrored by `matrix`."""
    return np.asarray(turn_mesh(jnp.asarray(goal), jnp.asarray(matrix, jnp.float32)))
