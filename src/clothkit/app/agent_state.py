"""What an agent knows in a session, by value, and how an observation, a plan and its execution change it.

The decisions are those of `planning.agent`. `Agent` keeps the newest state for its person; the viewer has one for each
moment that it shows.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from clothkit.app import planner as plans
from clothkit.app.inputs import Input, Settings
from clothkit.app.planner import (
    Planned,
    State,
    decide,
    goal_of,
    memory_after,
    observation_of,
    planned_of,
)
from clothkit.app.reach import reached
from clothkit.manipulation.vector import is_null
from clothkit.planning import agent
from clothkit.planning.lengths import LengthConfig
from clothkit.planning.perception import KnownMeshes, sigma_of
from clothkit.planning.planner import Planner
from clothkit.planning.plans import expectation
from clothkit.planning.reach import Limits
from clothkit.planning.types import UNKNOWN, Memory, Observation, Plan
from clothkit.runtime.errors import InputError


@dataclasses.dataclass(frozen=True)
class Perceived:
    """The last observation, and what the agent takes it for."""

    source: Input
    observation: Observation
    """As a batch of one."""
    state: State
    """In the labels of what was expected, if anything was."""
    candidates: Float[np.ndarray, "candidate 2"]
    """Grasp points in the coordinates of the nets' inputs, NaN where there are fewer."""
    sigma: float = np.nan
    """How unsure the perception is of the state [cloth length]."""
    std: Float[np.ndarray, "u v 3"] | None = None
    """The standard deviations of an estimated mesh, in the labels of `state` [normalised]; None: not estimated."""


@dataclasses.dataclass(frozen=True)
class AgentState:
    """All that an agent knows: the goal, its memory, the cloth as it lies, and the plan that was made for it."""

    planner: Planner
    settings: Settings
    goal: Input
    memory: Memory
    """Before the next decision, as a batch of one; its goal is the one that is planned for."""
    choosing: LengthConfig | None = None
    """How the agent chooses how many of the manipulations that are left are worth it; None: it uses all."""
    matrix: Float[np.ndarray, "2 2"] | None = None
    """What the goal was turned or mirrored by; None: it was not."""
    perceived: Perceived | None = None
    planned: Planned | None = None
    """The plan that waits to be executed."""

    @property
    def target(self) -> State:
        """The goal in the system's representation, turned by `matrix`."""
        return self.memory.goal[0]

    @property
    def left(self) -> int:
        """The number of manipulations that are left, without the first of the plan that waits.

        None is, if the agent chose how many are worth it, and chose none.
        """
        return 0 if self.over else int(self.memory.left[0]) - (self.planned is not None)

    @property
    def over(self) -> bool:
        """Whether the agent chose to do nothing more."""
        choice = None if self.planned is None else self.planned.choice
        return choice is not None and int(choice.length[0]) == 0


def begin(
    planner: Planner, settings: Settings, goal: Input, length: int, choosing: LengthConfig | None = None
) -> AgentState:
    """A session of `length` manipulations or, with `choosing`, of as many of them as are worth it.

    Raises InputError when the goal can't be planned for.
    """
    target = goal_of(planner.system, goal, settings.data, settings)
    return AgentState(planner, settings, goal, plans.begin(planner, target, length, goal.cloth), choosing)


def observe(now: AgentState, source: Input) -> AgentState:
    """The state after an observation of the cloth; a plan that was made before is dropped.

    Raises InputError when the system can't plan from it.
    """
    observation = observation_of(now.planner, source, now.settings.data, now.settings)
    states, candidates = agent.perceive(now.planner, observation, now.memory)
    stds = agent.doubt(now.planner, observation, states, now.memory)
    sigma, std = float(sigma_of(states, stds)[0]), None if stds is None else stds[0]
    perceived = Perceived(source, observation, states[0], candidates[0], sigma, std)
    return dataclasses.replace(now, perceived=perceived, planned=None)


def plan(now: AgentState, *, seed: int, limits: Limits = Limits()) -> AgentState:  # noqa: B008
    """The state with a plan for the manipulations that are left, within the limits of the hands.

    Raises InputError when nothing was observed, no manipulation is left, or no plan within the limits was found.
    """
    perceived = now.perceived
    if perceived is None:
        raise InputError("agent: has observed nothing since the session began, expected an observation to plan from")
    if not now.memory.left[0]:
        raise InputError("agent: the session is over, expected manipulations that are left to plan")
    planned, _ = decide(
        *_known(now.planner, perceived.state),
        now.memory,
        seed=seed,
        length=now.choosing,
        trust=now.settings.trust_in(now.planner.system),
        sigma=perceived.sigma,
    )
    planned = planned._replace(sigma=perceived.sigma)
    return kept_within(limits, dataclasses.replace(now, planned=planned), seed=seed)


def kept_within(limits: Limits, now: AgentState, *, seed: int) -> AgentState:
    """The state with its plan within the limits of the hands: as it is, turned with its goal, or another one.

    Raises InputError when no such plan does anything.
    """
    perceived = now.perceived
    assert perceived is not None, "a state with an observation"
    assert now.planned is not None, "a state with a plan"
    planned, turn = reached(
        now.planner,
        now.planned,
        now.memory,
        perceived.candidates,
        perceived.source.pose,
        now.settings.app.motion,
        limits,
        seed=seed,
    )
    if planned is not now.planned:
        planned = planned._replace(sigma=perceived.sigma)
    if turn is not None:
        now = turned(now, turn)
        if now.memory.relative[0] != UNKNOWN:
            # The relabelling that brings the goal under the state's labels is another one for the turned goal.
            relative = np.full_like(now.memory.relative, planned.relative)
            now = dataclasses.replace(now, memory=now.memory._replace(relative=relative))
    return dataclasses.replace(now, planned=planned)


def with_goal(now: AgentState, goal: Input) -> AgentState:
    """The state with another goal in the place of its own, turned as that was. Raises InputError."""
    target = goal_of(now.planner.system, goal, now.settings.data, now.settings)
    found = dataclasses.replace(now, goal=goal, memory=now.memory._replace(goal=target[None]), matrix=None)
    return found if now.matrix is None else turned(found, now.matrix)


def turned(now: AgentState, matrix: Float[np.ndarray, "2 2"]) -> AgentState:
    """The state with its goal, a mesh, turned or mirrored by a matrix."""
    memory = now.memory._replace(goal=plans.turned_goal(now.target, matrix)[None])
    return dataclasses.replace(now, memory=memory, matrix=matrix if now.matrix is None else matrix @ now.matrix)


def with_plan(now: AgentState, found: Plan) -> AgentState:
    """The state with a plan that a search found for what was perceived, as a batch of one."""
    assert now.perceived is not None, "a state with an observation"
    planned = planned_of(now.planner, found, now.memory)._replace(sigma=now.perceived.sigma)
    return dataclasses.replace(now, planned=planned)


def advanced(now: AgentState, *, executed: bool) -> AgentState:
    """The state after the plan's first manipulation, or after it was left out; the cloth is still perceived as before.

    A null manipulation is never executed.
    """
    planned = now.planned
    assert planned is not None, "a state with a plan"
    executed = executed and not bool(is_null(planned.plan[0]))
    memory = memory_after(
        now.planner,
        now.memory,
        planned.state,
        planned.plan,
        common=planned.common,
        relative=planned.relative,
        traces=planned.traces,
        predicted=expectation(planned.means[:, 0], None if planned.stds is None else planned.stds[:, 0])
        if executed
        else None,
        left=0 if now.over else int(now.memory.left[0]) - 1,
    )
    return dataclasses.replace(now, memory=memory, planned=None)


def _known(planner: Planner, state: State) -> tuple[Planner, Observation]:
    """A planner that takes a state for what it was perceived as, and the observation of it."""
    if planner.system.voxels:
        return planner, Observation(voxels=state[None] > 0)
    return dataclasses.replace(planner, perception=KnownMeshes()), Observation(meshes=state[None])
