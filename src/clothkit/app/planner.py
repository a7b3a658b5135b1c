"""The agent's decisions for one cloth, as the command line and the viewer need them: files in, a plan out."""

import dataclasses
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Shaped

from clothkit.app.inputs import Input, Settings, Usage
from clothkit.cloth.mesh import best_label
from clothkit.cloth.symmetry import relabel_manipulation
from clothkit.cloth.topology import PAPERS_CLOTH, SQUARE
from clothkit.estimation.estimate import Alternatives, Estimate, alternatives, estimate
from clothkit.manipulation.turns import turn_manipulation, turn_mesh
from clothkit.manipulation.vector import is_null
from clothkit.models import store
from clothkit.models.net import Net
from clothkit.planning import agent, optimisers
from clothkit.planning.batches import take
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.lengths import LengthConfig
from clothkit.planning.perception import Estimation, Expected, KnownMeshes
from clothkit.planning.planner import Planner, artifacts, assemble
from clothkit.planning.predict import Prediction, differences, predict
from clothkit.planning.systems import System
from clothkit.planning.trust import Signs, Trusted, of_error, signs_of, tells, trusted
from clothkit.planning.types import Choice, Memory, Observation, Plan
from clothkit.runtime.errors import InputError

State = Shaped[np.ndarray, "*state"]
"""A state as a system represents it: a mesh [u v 3], normalised and centred, or voxels [x y z]."""

Traces = tuple[Float[np.ndarray, "labels latent"], ...]
"""For each net, the memory traces of one cloth for all common equivalents of its state."""


VTM = Path("nets/vtm")
"""Place of the net that estimates meshes, under the folder of all artifacts."""


class Planned(NamedTuple):
    """A plan for one cloth and the nets' predictions for it, in the labels of the state."""

    state: State
    plan: Float[np.ndarray, "n 6"]
    common: int
    """The Cartesian equivalent in which the plan was found, 0..7 (0 for voxels)."""
    relative: int
    """The relabelling that brings the goal under the state's labels."""
    means: Shaped[np.ndarray, "net n *state"]
    """Each net's predicted means after each manipulation; for voxels, the predicted occupancy 0..1."""
    stds: Float[np.ndarray, "net n *state"] | None
    """The standard deviations of the predictions; None for voxels."""
    shifts: Float[np.ndarray, "n 2"]
    """Shift of the cloth's centre by each manipulation, as the best net predicts it [normalised]."""
    differences: Float[np.ndarray, " n"] | None
    """diff of eq. (15) after each manipulation; None if there is only one net."""
    traces: Traces
    """Each net's memory traces before the plan."""
    cloth: Float[np.ndarray, "3"] = PAPERS_CLOTH
    """Sides and thickness of the cloth, in the labels of the state [normalised]."""
    loss: float = np.nan
    expected: float = np.nan
    """Distance of the nets' mean predicted outcome from the goal, in the labelling that was found and the measure of
    the null check: aligned [cloth length], or the mean difference of voxels."""
    expected_no_action: float = np.nan
    """The same of the state."""
    model_error: float = np.nan
    """Expected error of the predicted outcome [cloth length]; NaN if the planner has no such measure."""
    sigma: float = np.nan
    """How unsure the perception is of the state [cloth length]."""
    useless: bool = False
    """Whether the agent found that the plan is not expected to bring the state nearer to its goal."""
    without_limits: float = np.nan
    """`expected` of the plan that this one was searched for in place of, to keep within limits; NaN: of none."""
    choice: Choice | None = None
    """How the agent chose the number of manipulations, as a batch of one; None: it was told."""

    @property
    def improves(self) -> bool:
        """Whether the plan is expected to improve the state: it is not useless, and does something."""
        return not self.useless and not bool(np.all(is_null(self.plan)))

    @property
    def prediction_error(self) -> float | None:
        """`model_error`; None if it is not known, or the plan does nothing, so that nothing has to be predicted."""
        known = np.isfinite(self.model_error) and not bool(np.all(is_null(self.plan)))
        return self.model_error if known else None


def load_planner(system: System, data: Path, settings: Settings, *, optimiser: str | None = None) -> Planner:
    """Load the planner of a system, for one cloth whose labels are not those of its goal.

    It searches by the optimiser of that name: with the settings' own sizes if that is the one they have, else with the
    optimiser's usual ones.

    Raises InputError that names a missing or broken artifact.
    """
    found = artifacts(system, data, settings.members, settings.plan.uncertainty.measure)
    for path in found.values():
        if not path.exists():
            raise InputError(f"{path}: not found, system {system.name} plans with it; dvc repro makes it")
        if path.is_dir():
            store.description(path)
    planner = assemble(system, data, settings.weights, settings.plan, settings.grasping, settings.members)
    if optimiser is not None and optimiser != optimisers.optimiser_of(planner.settings.search.optimiser).name:
        search = dataclasses.replace(planner.settings.search, optimiser=optimisers.optimiser(optimiser).settings())
        planner = dataclasses.replace(planner, settings=dataclasses.replace(planner.settings, search=search))
    return for_one_cloth(planner)


def for_one_cloth(planner: Planner) -> Planner:
    """The planner for one cloth at a time, whose labels are not those of its goal."""
    perception = planner.perception
    if isinstance(perception, Estimation):
        perception = dataclasses.replace(perception, batch=1)
    elif isinstance(perception, KnownMeshes):
        perception = KnownMeshes(labelled=False)
    one = dataclasses.replace(planner.settings, batch=1)
    return dataclasses.replace(planner, perception=perception, settings=one, labelled=planner.system.voxels)


def load_vtm(data: Path) -> Net:
    """Load VtM, the net that estimates meshes from voxels.

    Raises InputError if it is missing or broken.
    """
    path = data / VTM
    if not path.exists():
        raise InputError(f"{path}: not found, it sees meshes in voxels; dvc repro makes it")
    return store.load(path, "vtm")


def estimate_mesh(vtm: Net, source: Input, settings: Settings) -> Estimate:
    """Estimate the mesh of one cloth of which nothing is expected yet, as a batch of one."""
    return estimate(vtm, source.observation.voxels[None], settings.plan.refine, cloth=source.cloth[None])


def alternatives_of(vtm: Net, source: Input, settings: Settings) -> Alternatives:
    """All shapes that an observation may show, as a batch of one."""
    return alternatives(vtm, source.observation.voxels[None], settings.plan.refine, cloth=source.cloth[None])


def observation_of(planner: Planner, source: Input, data: Path, settings: Settings) -> Observation:
    """What a planner observes of a file's content, as a batch of one.

    Raises InputError when its system needs a mesh and the file holds none, and when it takes voxels of another viewport
    than the net in `data` that estimates meshes.
    """
    system, viewport = planner.system, planner.perception.viewport
    if viewport not in (None, settings.app.cloud.viewport):
        raise InputError(
            f"{data / VTM}: knows voxels up to {settings.app.cloud.viewport.height:g}, system {system.name} plans with "
            f"nets that know them up to {viewport.height:g}"
        )
    if not system.true_meshes:
        return Observation(voxels=source.observation.voxels[None])
    mesh = mesh_of(source)
    if mesh is None:
        raise InputError(
            f"{source.file}: holds {source.kind}, but system {system.name} plans from a mesh [32, 32, 3]; "
            "system main estimates it"
        )
    return Observation(meshes=mesh[None].astype(np.float32))


def goal_of(system: System, source: Input, data: Path, settings: Settings) -> State:
    """Return a goal in the system's representation: voxels, the file's mesh, or an estimate if there is no mesh."""
    if system.voxels:
        return source.observation.voxels
    mesh = mesh_of(source)
    return np.asarray(estimate_mesh(load_vtm(data), source, settings).mesh[0]) if mesh is None else mesh


def usage_of(system: System, source: Input, *, goal: bool = False) -> Usage:
    """Return whether a system plans from (or for) a file's content as it is, or an estimate of it."""
    as_it_is = system.voxels or (mesh_of(source) is not None and (goal or system.true_meshes))
    return "as it is" if as_it_is else "estimated"


def mesh_of(source: Input) -> Float[np.ndarray, "u v 3"] | None:
    """The mesh that a file holds [normalised, centred], None if it holds anything else."""
    return getattr(source.state, "mesh", None)


def begin(planner: Planner, goal: State, length: int, cloth: Float[np.ndarray, "3"] = PAPERS_CLOTH) -> Memory:
    """The memory before the first decision, a batch of one. For every system a goal is reached in any of its labels.

    `cloth` are the cloth's sides and thickness [normalised].
    """
    return agent.begin(planner, goal[None], np.array([length]), cloth[None])


def decide(
    planner: Planner,
    observation: Observation,
    memory: Memory,
    *,
    seed: int,
    length: LengthConfig | None = None,
    trust: ErrorMap | None = None,
    sigma: float | None = None,
) -> tuple[Planned, Memory]:
    """The agent's decision for one cloth: the plan, and the memory after its first manipulation.

    `length`, `trust` and `sigma` are those of `agent.decide`. Raises InputError when the nets have no reference values
    for plans of that length.
    """
    key, unsure = jax.random.key(seed).reshape(1), None if sigma is None else np.array([sigma])
    plan, later = agent.decide(planner, observation, memory, key=key, length=length, trust=trust, sigma=unsure)
    return planned_of(planner, plan, memory), later


def planned_of(planner: Planner, plan: Plan, memory: Memory) -> Planned:
    """The only plan of a batch; `memory` is that before the plan."""
    one, n = take(plan, 0), int(plan.length[0])
    goal = planner.representation.relabel(memory.goal, plan.relative)
    return Planned(
        state=one.state,
        plan=one.manipulations[:n],
        common=int(one.common),
        relative=int(one.relative),
        means=np.swapaxes(one.means[:n], 0, 1),
        stds=None if one.stds is None else np.swapaxes(one.stds[:n], 0, 1),
        shifts=one.shifts[:n, planner.best],
        differences=None if one.differences is None else one.differences[:n],
        traces=take(memory.traces, 0),
        cloth=memory.cloth[0],
        loss=float(one.loss),
        expected=float(one.expected),
        expected_no_action=float(planner.representation.distance(plan.state, goal)[0]),
        model_error=float(signs_of(plan, np.zeros(1), planner.settings.uncertainty.measure).model_error[0]),
        useless=bool(one.useless),
        choice=plan.choice,
    )


def predict_plan(
    planner: Planner,
    state: State,
    plan: Float[np.ndarray, "n 6"],
    *,
    common: int,
    traces: Traces,
    cloth: Float[np.ndarray, "3"] = PAPERS_CLOTH,
) -> Planned:
    """Predict the states after each manipulation of a plan, whatever its goal: `relative` is 0, losses are NaN."""
    found = _predictions(planner, state, plan, common, traces, cloth)
    representation = planner.representation
    stds = [std for of_net in found if (std := representation.std(of_net.states)) is not None]
    apart = differences(representation, found)
    return Planned(
        state,
        plan,
        common,
        0,
        means=np.concatenate([representation.mean(of_net.states) for of_net in found]),
        stds=np.concatenate(stds) if stds else None,
        shifts=np.asarray(found[planner.best].shifts[0]),
        differences=None if apart is None else np.asarray(apart[0]),
        traces=traces,
        cloth=cloth,
    )


def traces_after(
    planner: Planner,
    state: State,
    plan: Float[np.ndarray, "n 6"],
    *,
    common: int,
    traces: Traces,
    cloth: Float[np.ndarray, "3"] = PAPERS_CLOTH,
) -> Traces:
    """Return each net's memory traces after the first manipulation of a plan."""
    found = _predictions(planner, state, plan, common, traces, cloth)
    return tuple(np.asarray(of_net.traces[0]) for of_net in found)


def memory_after(
    planner: Planner,
    before: Memory,
    state: State,
    plan: Float[np.ndarray, "n 6"],
    *,
    common: int,
    relative: int,
    traces: Traces,
    predicted: Expected | None,
    left: int,
) -> Memory:
    """Return what the decision after a plan's first step needs (section 5.1), as a batch of one.

    `before` is the memory before the plan, with the goal that the plan leads to, and `traces` are those before it.
    `predicted` is what the nets predict of the state after the first step; None: the step was not executed, so that
    the expected state and the traces are those before it; before the first plan, what was perceived. In both cases the
    cloth is observed anew. `left` is how many manipulations are left.
    """
    expected = Expected(state, np.full(state.shape, np.inf))
    if predicted is None and before.planned[0]:
        # The cloth lies as the last executed manipulation left it.
        expected = Expected(before.expected[0], before.unsure[0])
    if predicted is not None:
        expected = predicted
        traces = traces_after(planner, state, plan, common=common, traces=traces, cloth=before.cloth[0])
    rest = np.full_like(before.rest, np.nan)
    rest[0, : len(plan) - 1] = plan[1:]
    return before._replace(
        left=np.array([left], np.int64),
        planned=np.ones(1, bool),
        still=np.zeros(1, bool),
        relative=np.array([relative], np.int32),
        rest=rest,
        expected=expected.mean[None].astype(np.float32),
        unsure=expected.std[None].astype(np.float32),
        traces=tuple(trace[None] for trace in traces),
    )


def _predictions(
    planner: Planner,
    state: State,
    plan: Float[np.ndarray, "n 6"],
    common: int,
    traces: Traces,
    cloth: Float[np.ndarray, "3"],
) -> tuple[Prediction, ...]:
    each = tuple(trace[None] for trace in traces)
    start = np.asarray(state, np.float32)[None]
    return predict(
        planner.model,
        planner.representation,
        planner.nets,
        start,
        each,
        plan[None],
        np.array([common]),
        cloth[None],
    )


def trusted_of(planned: Planned, settings: Settings, system: System) -> Trusted | None:
    """What plans with such an expectation came to; None if that is not known, or the system is another than main."""
    if (trust := settings.trust_in(system)) is None:
        return None
    # As in the plans that were executed: one that is not expected to improve is left undone.
    expected = planned.expected_no_action if planned.useless else planned.expected
    signs = Signs(*(np.array([value]) for value in (expected, planned.model_error, planned.sigma)))
    if not tells(trust, signs):
        return None
    told = trusted(trust, signs, np.array([len(planned.plan)]))
    if np.isfinite(planned.without_limits) and told.error[0] < expected:
        # No plan with limits was executed for the map: that such a one ends nearer than expected is not known.
        return of_error(trust, np.array([expected]))
    return told


def turned_plan(planner: Planner, planned: Planned, goal: State, matrix: Float[np.ndarray, "2 2"]) -> Planned:
    """Return the plan turned or mirrored by `matrix`, a symmetry of the state; its goal is the turned one.

    The state keeps its place and its labels, and only the manipulations turn. The nets' predictions and what is
    expected of them are computed again for the turned plan; loss and doubt are those of the original, and so is the
    decision whether it is useless.
    """
    turn = jnp.asarray(matrix, jnp.float32)
    turns = jnp.broadcast_to(turn, (len(planned.plan), 2, 2))
    turned = turn_mesh(jnp.asarray(planned.state), turn)
    k = int(best_label(turned, planned.state, cloth=planned.cloth))
    back = int(SQUARE.inverses[k])
    plan = relabel_manipulation(turn_manipulation(jnp.asarray(planned.plan), turns), back)
    common = int(SQUARE.composed[k, planned.common])
    found = predict_plan(
        planner, planned.state, np.asarray(plan), common=common, traces=planned.traces, cloth=planned.cloth
    )
    relative, representation = int(SQUARE.composed[planned.relative, back]), planner.representation
    labelled = representation.relabel(turned_goal(goal, matrix)[None], np.array([relative]))
    expected, no_action = (
        float(representation.distance(state[None], labelled)[0]) for state in (found.means[:, -1].mean(0), found.state)
    )
    return found._replace(
        relative=relative,
        loss=planned.loss,
        expected=expected,
        expected_no_action=no_action,
        model_error=planned.model_error,
        sigma=planned.sigma,
        useless=planned.useless,
        choice=planned.choice,
    )


def turned_goal(goal: State, matrix: Float[np.ndarray, "2 2"]) -> State:
    """Return a goal mesh turned or mirrored by `matrix`."""
    return np.asarray(turn_mesh(jnp.asarray(goal), jnp.asarray(matrix, jnp.float32)))
