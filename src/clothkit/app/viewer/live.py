"""A live session: search for a plan, simulate its first manipulation, observe, and search again.

The decisions are those of `planning.agent`, with two differences: a person starts each action, and may execute a plan
that is not expected to improve the state. If a file holds no mesh, the estimate is simulated; a tangled estimate takes
long to simulate.
"""

import dataclasses
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothkit.app import planner as plans
from clothkit.app.inputs import Input, Settings
from clothkit.app.planner import epistemic_uncertainty, estimate_mesh, goal_of, load_vtm, mesh_of, observation_of
from clothkit.app.viewer.search_progress import OnProgress, Progress, search_in_batches
from clothkit.app.viewer.session import Mesh, Session, ShownPlan, StateEstimate, Step, error_of, matched
from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.estimation.estimate import estimate_probabilistic
from clothkit.manipulation.vector import is_null, is_single
from clothkit.observation.observe import observe
from clothkit.observation.states import MeshState
from clothkit.planning import agent
from clothkit.planning.perception import Estimation
from clothkit.planning.planner import Planner
from clothkit.planning.types import Memory, Observation, Plan
from clothkit.runtime.errors import InputError
from clothkit.simulation.cloths import simulated_cloths
from clothkit.simulation.executor import execute


@dataclasses.dataclass(frozen=True)
class Live:
    """A running session, and the inputs of its next plan."""

    session: Session
    planner: Planner
    data: Path
    settings: Settings
    centre: Float[np.ndarray, "2"]
    """Position of the cloth's centre on the table [normalised]."""
    estimate: StateEstimate
    """The system's estimate of the current state, in the estimate's own labels."""
    memory: Memory
    """The agent's memory before the next plan, as a batch of one."""
    plan: Plan | None = None
    """The plan that waits to be executed, as a batch of one."""

    @property
    def at(self) -> int:
        """Number of manipulations that are done."""
        return len(self.session.states) - 1

    @property
    def left(self) -> int:
        """Number of manipulations that are left."""
        return self.session.length - self.at


def begin(
    planner: Planner, start: Input, goal: Input, length: int, *, title: str, data: Path, settings: Settings
) -> Live:
    """Start a session of `length` manipulations; it has no plan yet.

    The mesh in the file of `start` is simulated or, if there is none, the estimate. Raises InputError when the system
    cannot plan from these files.
    """
    system, observation = planner.system, observation_of(planner, start, data, settings)
    truth, mesh = mesh_of(start), mesh_of(goal)
    if truth is None and system.voxels:
        truth = np.asarray(estimate_mesh(load_vtm(data), start, settings).mesh[0])
    target = goal_of(system, goal, data, settings)
    memory = plans.begin(planner, target, length, start.cloth)
    estimate = estimate_state(planner, observation, memory)
    if truth is None:
        truth = estimate.state
    shown = Session(title, length, target if mesh is None else mesh, (truth,), (matched(Step(estimate), truth),))
    centre = np.asarray(start.pose.centre / start.pose.scale, np.float32)
    return Live(shown, planner, data, settings, centre, estimate, memory)


def estimate_state(planner: Planner, observation: Observation, memory: Memory) -> StateEstimate:
    """Return the system's estimate of a cloth, with standard deviations if it is a refined one."""
    states, points = agent.perceive(planner, observation, memory)
    sigma, perception = None, planner.perception
    if isinstance(perception, Estimation) and perception.refine and observation.voxels is not None:
        # Of several hypotheses, that which the state was refined from is the nearest one.
        found = estimate_probabilistic(perception.vtm, observation.voxels, states, cloth=memory.cloth)
        sigma = np.asarray(found.std[0])
    return StateEstimate(states[0], sigma, points[0][np.isfinite(points[0]).all(-1)])


def plan(live: Live, *, seed: int, on_progress: OnProgress) -> Live:
    """Search for a plan for the manipulations that are left, and return the session with it.

    Raises InputError when no manipulation is left.
    """
    if not live.left:
        raise InputError("session: is over, expected manipulations that are left to plan")
    candidates = np.full((live.planner.grasping.most, 2), np.nan, np.float32)
    candidates[: len(live.estimate.candidates)] = live.estimate.candidates
    progress = search_in_batches(
        live.planner, live.estimate.state, candidates, live.memory, seed=seed, on_progress=on_progress
    )
    return with_progress(live, progress)


def with_progress(live: Live, progress: Progress) -> Live:
    """Return the session with the best plan of a search so far."""
    best = progress.best
    if best is None:
        return dataclasses.replace(live, plan=None, session=_with_step(live.session, Step(live.estimate)))
    planned = plans.planned_of(live.planner, best, live.memory)
    shown = ShownPlan(
        manipulations=planned.plan,
        members=live.planner.members,
        means=planned.means,
        sigmas=planned.stds,
        uncertainty=epistemic_uncertainty(live.planner, planned),
        loss=planned.loss,
        progress=progress.lowest,
        tried=progress.tried,
        improves=planned.improves,
        expected=None if live.planner.system.voxels else planned.expected,
        expected_no_action=None if live.planner.system.voxels else planned.expected_no_action,
    )
    return dataclasses.replace(live, plan=best, session=_with_step(live.session, Step(live.estimate, shown)))


def _with_step(session: Session, step: Step) -> Session:
    """Return the session with its last step replaced by `step`."""
    return session._replace(steps=(*session.steps[:-1], matched(step, session.states[-1])))


def perform(live: Live) -> Live:
    """Simulate the first manipulation of the plan, and return the session after it. A null one changes nothing.

    Raises InputError when there is no plan or the outcome is not finite.
    """
    if live.plan is None:
        raise InputError("session: has no plan, expected one to execute")
    first = live.plan.manipulations[0, 0]
    null = bool(is_null(first))
    truth, centre = (live.session.states[-1], live.centre) if null else _simulated(live, first)
    memory = agent.remember(live.planner, live.memory, live.plan, executed=np.array([not null]))
    estimate = live.estimate
    session = live.session._replace(states=(*live.session.states, truth), steps=_noted(live, null, truth))
    if not session.over:
        if not null:
            source = _observe(truth, centre, live)
            observation = observation_of(live.planner, source, live.data, live.settings)
            estimate = estimate_state(live.planner, observation, memory)
        session = session._replace(steps=(*session.steps, matched(Step(estimate), truth)))
    return dataclasses.replace(live, session=session, centre=centre, estimate=estimate, memory=memory, plan=None)


def _noted(live: Live, null: bool, outcome: Mesh) -> tuple[Step, ...]:
    *before, step = live.session.steps
    assert step.plan is not None
    after = error_of(outcome, live.session.goal)
    note = "its first manipulation is too short to be executed: nothing was done" if null else "executed"
    note += "" if after is None else f", error after it **{after:.3f}**"
    return (*before, step._replace(plan=step.plan._replace(note=note)))


def _simulated(live: Live, manipulation: Float[np.ndarray, "6"]) -> tuple[Mesh, Float[np.ndarray, "2"]]:
    mesh = live.session.states[-1] + np.append(live.centre, 0).astype(np.float32)
    places = live.planner.representation.positions(live.estimate.state[None], manipulation[None, :4].reshape(1, 2, 2))
    run = partial(execute, settings=live.settings.simulation, workers=1)
    outcome = run(
        mesh[None],
        (places + live.centre).astype(np.float32),
        manipulation[None, 4:],
        np.asarray(is_single(manipulation[None])),
        simulated_cloths(live.memory.cloth, live.settings.simulation),
    )[0]
    if not np.isfinite(outcome).all():
        raise InputError("session: the manipulation has an outcome that is not finite")
    return centred(outcome)


def _observe(truth: Mesh, centre: Float[np.ndarray, "2"], live: Live) -> Input:
    """Observe the simulated cloth as a camera would."""
    settings = live.settings.app
    state = MeshState(truth, centre, settings.side / CLOTH_LENGTH)
    observation = observe(state, cloth_side=settings.side, settings=settings.cloud)
    return Input("simulation", state, observation, live.memory.cloth[0])
