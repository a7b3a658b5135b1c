"""A live session: search for a plan, simulate its first manipulation, observe, and search again.

The decisions are those of `planning.agent`, with two differences: a person starts each action, and may execute a plan
that is not expected to improve the state. If a file holds no mesh, the estimate is simulated; a tangled estimate takes
long to simulate.
"""

import dataclasses
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from clothkit.app import agent_state
from clothkit.app.advice import Signs, is_flat, told_of, warning_of
from clothkit.app.agent_state import AgentState
from clothkit.app.agreement import compare_goal, compare_state
from clothkit.app.describe import unsure_of
from clothkit.app.inputs import Input, Settings
from clothkit.app.lengths import AUTO, check_can_choose
from clothkit.app.planner import Planned, estimate_mesh, load_vtm, mesh_of, trusted_of
from clothkit.app.reach import limits_of
from clothkit.app.viewer.search_progress import OnProgress, Progress, search_in_batches
from clothkit.app.viewer.session import Mesh, Session, StateEstimate, Step, error_of, matched, shown_plan
from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.dataset.store import STEPS
from clothkit.manipulation.vector import is_null, is_single
from clothkit.observation.observe import observe
from clothkit.observation.states import MeshState
from clothkit.planning.planner import Planner
from clothkit.planning.types import Memory
from clothkit.runtime.errors import InputError
from clothkit.simulation.cloths import simulated_cloths
from clothkit.simulation.executor import execute


@dataclasses.dataclass(frozen=True)
class Live:
    """A running session, and what its agent knows."""

    session: Session
    agent: AgentState
    estimate: StateEstimate
    """What the agent perceives, in the agent's labels."""
    centre: Float[np.ndarray, "2"]
    """Position of the cloth's centre on the table [normalised]."""

    @property
    def at(self) -> int:
        """Number of manipulations that are done."""
        return len(self.session.states) - 1

    @property
    def left(self) -> int:
        """Number of manipulations that are left; none if the agent chose to do nothing more."""
        return 0 if self.agent.over else self.session.length - self.at

    @property
    def memory(self) -> Memory:
        """The agent's memory before the next plan, as a batch of one."""
        return self.agent.memory

    @property
    def plan(self) -> Planned | None:
        """The plan that waits to be executed."""
        return self.agent.planned


def begin(
    planner: Planner,
    start: Input,
    goal: Input,
    steps: int | Literal["auto"],
    *,
    title: str,
    data: Path,
    settings: Settings,
) -> Live:
    """Start a session of some manipulations, or of as many as the agent finds worth it; it has no plan yet.

    The mesh in the file of `start` is simulated or, if there is none, the estimate. Raises InputError when the system
    cannot plan from these files.
    """
    length, choosing = (STEPS, settings.app.length) if steps == AUTO else (steps, None)
    if choosing is not None:
        check_can_choose(planner.system)
    agent = agent_state.begin(planner, settings._replace(data=data), goal, length, choosing)
    agent = agent_state.observe(agent, start)
    truth, mesh = mesh_of(start), mesh_of(goal)
    if truth is None and planner.system.voxels:
        truth = np.asarray(estimate_mesh(load_vtm(data), start, settings).mesh[0])
    estimate = estimate_of(agent)
    if truth is None:
        truth = estimate.state
    shown_goal = agent.target if mesh is None else mesh
    centre = np.asarray(start.pose.centre / start.pose.scale, np.float32)
    first = matched(Step(estimate), truth, start.cloth)
    shown = Session(title, length, shown_goal, (truth,), (first,), (centre,), start.cloth)
    return Live(shown, agent, estimate, centre)


def estimate_of(agent: AgentState) -> StateEstimate:
    """Return what an agent perceives, with standard deviations if it is an estimate."""
    perceived = agent.perceived
    assert perceived is not None, "an agent that has observed the cloth"
    points = perceived.candidates
    return StateEstimate(perceived.state, perceived.std, points[np.isfinite(points).all(-1)])


def notices_of(live: Live) -> list[str]:
    """Return what speaks against the agent's estimates and its plan, if there is one, and what to do about it."""
    agent = live.agent
    perceived, system = agent.perceived, agent.planner.system
    assert perceived is not None, "a session that has begun"
    agreements = (
        compare_state(system, perceived.source, perceived.state, agent.settings),
        compare_goal(system, agent.goal, agent.target, agent.settings),
    )
    pose, planned = perceived.source.pose, agent.planned
    signs = Signs(*agreements, unsure_of(perceived.source, perceived.state, perceived.std, pose))
    if planned is not None:
        told = trusted_of(planned, agent.settings, system)
        outcome = None if told is None else float(told.error[0])
        signs = signs._replace(
            trust=None if told is None else float(told.trust[0]),
            warning=warning_of(planned.improves, outcome, planned.expected_no_action),
            away=None if system.voxels else planned.expected_no_action,
            steps=len(planned.plan),
            flat=is_flat(perceived.state, perceived.source.cloth),
            named=None if agent.goal.variant is None else agent.goal.file,
        )
    return [*(a.sentence for a in agreements if a is not None and not a.reliable), *told_of(signs)]


def plan(live: Live, *, seed: int, on_progress: OnProgress) -> Live:
    """Search for a plan for the manipulations that are left, and return the session with it.

    An agent that chooses their number searches once for each, and tells of no progress in between. The plan is within
    the limits of the hands that the settings tell, if it can be. Raises InputError when it can't, or
    when no manipulation is left.
    """
    if not live.left:
        raise InputError("session: is over, expected manipulations that are left to plan")
    perceived = live.agent.perceived
    assert perceived is not None
    limits = limits_of(live.agent.settings.app)
    if live.agent.choosing is not None:
        progress = Progress(0, live.left, None, np.zeros(0, np.float32), 0)
        on_progress(progress)
        return _with_plan(live, agent_state.plan(live.agent, seed=seed, limits=limits), progress)
    progress = search_in_batches(
        live.agent.planner,
        perceived.state,
        perceived.candidates,
        live.memory,
        seed=seed,
        on_progress=on_progress,
    )
    found = with_progress(live, progress)
    if found.plan is None or not limits:
        return found
    agent = agent_state.kept_within(limits, found.agent, seed=seed)
    return found if agent.planned is found.plan else _with_plan(found, agent, progress)


def with_progress(live: Live, progress: Progress) -> Live:
    """Return the session with the best plan of a search so far."""
    if progress.best is None:
        agent = dataclasses.replace(live.agent, planned=None)
        return dataclasses.replace(live, agent=agent, session=_with_step(live.session, Step(live.estimate)))
    return _with_plan(live, agent_state.with_plan(live.agent, progress.best), progress)


def _with_plan(live: Live, agent: AgentState, progress: Progress) -> Live:
    """Return the session with the agent's plan, and with its goal if that was turned."""
    assert agent.planned is not None
    shown = shown_plan(
        agent.planner, agent.planned, progress=progress.lowest, tried=progress.tried, settings=agent.settings
    )
    session = live.session if agent.matrix is live.agent.matrix else live.session._replace(goal=agent.target)
    return dataclasses.replace(live, agent=agent, session=_with_step(session, Step(live.estimate, shown)))


def _with_step(session: Session, step: Step) -> Session:
    """Return the session with its last step replaced by `step`."""
    return session._replace(steps=(*session.steps[:-1], matched(step, session.states[-1], session.cloth)))


def perform(live: Live) -> Live:
    """Simulate the first manipulation of the plan, and return the session after it. A null one changes nothing.

    Raises InputError when there is no plan or the outcome is not finite.
    """
    if live.plan is None:
        raise InputError("session: has no plan, expected one to execute")
    first = live.plan.plan[0]
    null = bool(is_null(first))
    truth, centre = (live.session.states[-1], live.centre) if null else _simulated(live, first)
    agent = agent_state.advanced(live.agent, executed=True)
    estimate = live.estimate
    session = live.session._replace(
        states=(*live.session.states, truth),
        steps=_noted(live, null, truth),
        centres=(*live.session.centres, centre),
    )
    if not session.over:
        if not null:
            agent = agent_state.observe(agent, _observe(truth, centre, live))
            estimate = estimate_of(agent)
        session = session._replace(steps=(*session.steps, matched(Step(estimate), truth, session.cloth)))
    return Live(session, agent, estimate, centre)


def _noted(live: Live, null: bool, outcome: Mesh) -> tuple[Step, ...]:
    *before, step = live.session.steps
    assert step.plan is not None
    after = error_of(outcome, live.session.goal, live.session.cloth)
    note = "its first manipulation is too short to be executed: nothing was done" if null else "executed"
    note += "" if after is None else f", error after it **{after:.3f}**"
    return (*before, step._replace(plan=step.plan._replace(note=note)))


def _simulated(live: Live, manipulation: Float[np.ndarray, "6"]) -> tuple[Mesh, Float[np.ndarray, "2"]]:
    settings, representation = live.agent.settings.simulation, live.agent.planner.representation
    mesh = live.session.states[-1] + np.append(live.centre, 0).astype(np.float32)
    places = representation.positions(live.estimate.state[None], manipulation[None, :4].reshape(1, 2, 2))
    run = partial(execute, settings=settings, workers=1)
    outcome = run(
        mesh[None],
        (places + live.centre).astype(np.float32),
        manipulation[None, 4:],
        np.asarray(is_single(manipulation[None])),
        simulated_cloths(live.memory.cloth, settings),
    )[0]
    if not np.isfinite(outcome).all():
        raise InputError("session: the manipulation has an outcome that is not finite")
    return centred(outcome)


def _observe(truth: Mesh, centre: Float[np.ndarray, "2"], live: Live) -> Input:
    """Observe the simulated cloth as a camera would."""
    assert live.agent.perceived is not None, "a session that has begun"
    scale = live.agent.perceived.source.pose.scale
    state = MeshState(truth, centre, scale)
    observation = observe(state, cloth_side=scale * CLOTH_LENGTH, settings=live.agent.settings.app.cloud)
    return Input("simulation", state, observation, live.memory.cloth[0])
