"""One plan from one observation: a session's step for a cloth of which no truth is known (section 5.1)."""

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
from clothkit.errors import InputError
from clothkit.estimation.estimate import Estimate, estimate, estimate_unrefined
from clothkit.manipulation.turns import turn_manipulation, turn_mesh
from clothkit.networks import store
from clothkit.networks.net import Net
from clothkit.planning.draw import Candidates
from clothkit.planning.forward import Forward
from clothkit.planning.loss import uncertainty
from clothkit.planning.planner import Planner, artifacts, assemble
from clothkit.planning.predict import expect
from clothkit.planning.search import UNKNOWN, Found, Problem
from clothkit.planning.session import no_traces
from clothkit.planning.systems import System

Traces = tuple[Float[np.ndarray, "labels latent"], ...]
Believed = Shaped[np.ndarray, "*state"]
"""What a cloth is taken for: a mesh [u v 3], normalised and centred, or voxels [x y z]."""


class Past(NamedTuple):
    """What an earlier plan, whose first manipulation was executed, leaves to the next (section 5.1)."""

    expected: Believed
    """The better net's mean for the state that there should be now."""
    traces: Traces
    relative: int
    rest: Float[np.ndarray, "n 6"]
    """Its later manipulations."""


class Planned(NamedTuple):
    """A plan and what the nets expect of it, in the labels of the state."""

    state: Believed
    plan: Float[np.ndarray, "n 6"]
    common: int
    """The common equivalent in which it was found."""
    relative: int
    """The relabelling that brings the goal under the state's labels."""
    predictions: tuple[Any, ...]
    """Each net's, after each manipulation."""
    shifts: Float[np.ndarray, "n 2"]
    """By which the better net expects the cloth's centre to move [normalised]."""
    traces: Traces
    """The memory traces before it."""
    loss: float = np.nan


def planner_of(system: System, data: Path, settings: Settings) -> Planner:
    """A system with its nets. Raises InputError that names what is missing or broken."""
    found = artifacts(system, data)
    for name, path in found.items():
        if not path.exists():
            raise InputError(f"{path}: not found, system {system.name} plans with it; dvc repro makes it")
        if name != "reference":
            store.description(path)
    return assemble(system, data, settings.weights, settings.plan, settings.grasping)


def vtm_of(data: Path, settings: Settings) -> Net:
    """The net that sees meshes in voxels. Raises InputError, also when clouds become voxels of another height."""
    path = data / "nets/vtm"
    if not path.exists():
        raise InputError(f"{path}: not found, it sees meshes in voxels; dvc repro makes it")
    vtm, height = store.load(path, "vtm"), settings.app.cloud.height
    if height != vtm.config.height:
        raise InputError(f"app.cloud.height: is {height}, but {path} knows voxels up to {vtm.config.height}")
    return vtm


def estimated(vtm: Net, seen: Seen, settings: Settings, *, expected: Believed | None = None) -> Estimate:
    """The estimate of one cloth, in a batch of one; its labels and refinement follow what was expected of it."""
    predicted = None if expected is None else expected[None].astype(np.float32)
    return estimate(vtm, seen.observation.voxels[None], settings.plan.refine, predicted=predicted)


def believed(
    system: System, seen: Seen, data: Path, settings: Settings, *, expected: Believed | None = None
) -> Believed:
    """What the system takes a cloth for: voxels, a mesh as the file has it, or an estimate.

    Under the labels of what was expected, if anything was. Raises InputError when the system needs a mesh and the file
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
    """A goal as the system takes it: a mesh that the file holds is it, other shapes are estimated."""
    if system.voxels:
        return seen.observation.voxels
    mesh = mesh_of(seen)
    return np.asarray(estimated(vtm_of(data, settings), seen, settings).mesh[0]) if mesh is None else mesh


def taken(system: System, seen: Seen, *, goal: bool = False) -> Taken:
    """Whether a system plans from (or for) what a file holds, as it is, or from what is estimated of it."""
    as_it_is = system.voxels or (mesh_of(seen) is not None and (goal or system.true_meshes))
    return "as it is" if as_it_is else "estimated"


def mesh_of(seen: Seen) -> Float[np.ndarray, "u v 3"] | None:
    """The mesh that a file holds [normalised, centred], None if it holds anything else."""
    return getattr(seen.state, "mesh", None)


def like(mesh: Float[np.ndarray, "u v 3"], expected: Float[np.ndarray, "u v 3"]) -> Float[np.ndarray, "u v 3"]:
    """The equivalent of a mesh that comes nearest to what was expected."""
    return np.asarray(relabel(mesh, best_label(expected.astype(np.float32), mesh, aligned=True)))


def find_plan(
    planner: Planner, state: Believed, goal: Believed, length: int, *, seed: int, past: Past | None = None
) -> Planned:
    """The best plan that a search finds.

    Whatever the system, the goal may come in any labels: it is reached when some equivalent is. Raises InputError when
    the nets have no reference values for plans of that length.
    """
    problem = problem_of(planner, state, goal, length, past=past)
    found = find(planner.finder(length), problem, jax.random.key(seed))
    return planned_of(planner, problem, found)


def problem_of(planner: Planner, state: Believed, goal: Believed, length: int, *, past: Past | None = None) -> Problem:
    """What a search is asked. Raises InputError when the nets have no reference values for plans of that length."""
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
    """What one search finds, as NumPy."""
    problems = jax.tree.map(lambda leaf: np.asarray(leaf)[None], problem)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[0], finder(problems, key.reshape(1)))


def planned_of(planner: Planner, problem: Problem, found: Found) -> Planned:
    """A found plan, and what the nets expect of it."""
    traces = tuple(np.asarray(trace) for trace in problem.traces)
    planned = predicted(
        planner, np.asarray(problem.state), np.asarray(found.plan), common=int(found.common), traces=traces
    )
    return planned._replace(relative=int(found.relative), loss=float(found.loss))


def first_traces(planner: Planner) -> Traces:
    """t_0."""
    return tuple(trace[0] for trace in no_traces(planner, 1))


def predicted(
    planner: Planner, state: Believed, plan: Float[np.ndarray, "n 6"], *, common: int, traces: Traces
) -> Planned:
    """What the nets expect of a plan."""
    forward, k = planner.sight.forward, np.array([common])
    each = tuple(trace[None] for trace in traces)
    expected = expect(forward, planner.nets, state[None], each, plan[None], k)
    states = tuple(jax.tree.map(lambda leaf: np.asarray(leaf)[0], of_net.states) for of_net in expected)
    shifts = _centre_shifts(forward, planner.nets[planner.better], state, traces[planner.better], plan, k[0])
    return Planned(state, plan, common, 0, states, np.asarray(shifts), tuple(traces))


def traces_after(planner: Planner, planned: Planned) -> Traces:
    """The memory traces that the first manipulation of a plan leaves."""
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
    """u of eq. (15), the epistemic uncertainty of a plan; None for one net alone."""
    if len(planner.nets) == 1:
        return None
    differences = planner.sight.forward.diff(*jax.tree.map(jnp.asarray, planned.predictions))
    spread = planner.normalisation.reference(len(planned.plan)).spread
    return float(uncertainty(differences, spread, beta=planner.weights.beta, gamma=planner.weights.gamma))


def turned_plan(planner: Planner, planned: Planned, matrix: Float[np.ndarray, "2 2"]) -> Planned:
    """The same plan for the goal turned or mirrored by `matrix`, under which this cloth looks as before.

    The cloth stays as it is and keeps its labels; what was done to one part of it is done to that which the turn brings
    there. The nets are asked anew what they expect.
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
    """A goal mesh turned or mirrored."""
    return np.asarray(turn_mesh(jnp.asarray(goal), jnp.asarray(matrix, jnp.float32)))
