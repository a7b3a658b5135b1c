"""`Agent`: observe a cloth, plan, have the plan executed elsewhere, and observe again, from a person's own Python."""

import copy
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from clothkit.app import agent_state, planner
from clothkit.app.advice import Signs, told_of
from clothkit.app.agent_state import AgentState, Perceived
from clothkit.app.agreement import EstimateAgreement, compare_goal, compare_state
from clothkit.app.describe import Frame, PlanRequest, describe, frame_of, paths_of, unsure_of
from clothkit.app.inputs import Settings, keep_compiled_programs
from clothkit.app.lengths import AUTO, check_can_choose
from clothkit.app.named_goals import goal_like, goal_name, manipulations_of, named_goal, variant_before
from clothkit.app.observables import Mask, Observable, input_of
from clothkit.app.options import ObservationOptions, observation_options
from clothkit.app.output import check_target
from clothkit.app.plan_arrays import check_nets, cloth_of, memory_of, steps_left, traces_before
from clothkit.app.plan_file import Plan, read_plan
from clothkit.app.plan_parts import UnsurePart
from clothkit.app.prebuilt import load_nets
from clothkit.app.reach import check_limits, limits_of
from clothkit.app.viewer.recording import ENDING, write_recording
from clothkit.app.viewer.session import Session, StateEstimate, Step, shown_plan
from clothkit.cloth.mesh import error
from clothkit.cloth.voxels import Viewport
from clothkit.dataset.store import STEPS
from clothkit.goals.variants import Turn, Variant
from clothkit.manipulation.geometry import to_cartesian
from clothkit.observation.plane import plane_of
from clothkit.observation.pose import Pose
from clothkit.observation.side import Stated
from clothkit.planning.planner import Planner
from clothkit.planning.reach import Limits, hands_of
from clothkit.planning.systems import system as system_of
from clothkit.runtime.errors import InputError

Number = float | int
Numbers = Sequence[float | int]


@dataclasses.dataclass(frozen=True)
class ObservedCloth:
    """What an agent takes an observation for. Positions are in metres, in the frame of the agent's plans."""

    frame: Frame
    centre_m: Float[np.ndarray, "3"]
    """The middle of what the cloth covers, on the table."""
    vertices_m: Float[np.ndarray, "u v 3"] | None
    """The mesh, in the labels that the agent goes on with; None if its system plans in voxels."""
    grasps_m: Float[np.ndarray, "points 3"]
    """Where the next plan may grasp first; on the table below the cloth if its system plans in voxels."""
    error: float
    """Distance from the goal, moved to fit, in the best of its labels [cloth length]; mean difference of occupancy if
    the agent's system plans in voxels."""
    agreement: EstimateAgreement | None
    """How far the estimate agrees with the observation; None if nothing was estimated."""
    notices: tuple[str, ...]
    """What was not seen of the cloth, what speaks against the estimate, where it is poor, and what to do about that: a
    sentence each."""
    unsure: UnsurePart | None = None
    """Where the estimate is poor; None if nothing was estimated."""


class _NamedGoal(NamedTuple):
    """A named goal whose cloth has not been observed yet."""

    name: str
    turn: Turn | None
    mirror: bool | None


class Agent:
    """An agent of `planning.agent` that keeps its memory itself, for one cloth. Lengths are in metres.

        agent = Agent("data", side=0.4, table=(0, 0, -1, -0.8))
        agent.begin("goal.obj", steps=2)
        agent.observe(points)
        while agent.left:
            plan = agent.plan()
            if plan.expected.improves:
                ...  # hands follow the waypoints in plan.steps[0].hands
            agent.observe(points)

    Whatever is wrong with an input raises InputError, one sentence, and leaves the agent as it was.
    """

    def __init__(
        self,
        data: str | Path = "data",
        *,
        system: str = "main",
        settings: Settings | None = None,
        optimiser: str | None = None,
        side: Number | None = None,
        sides: Numbers | None = None,
        thickness: Number | None = None,
        table: Numbers | None = None,
        table_colour: Sequence[int] | None = None,
        box: Numbers | None = None,
        up: Numbers | None = None,
        viewpoint: Numbers | None = None,
        frame: Frame = "camera",
        limits: Limits | None = None,
    ) -> None:
        """Load the nets of a system from the folder `data`. The other options are those of `clothkit plan`.

        System main estimates a mesh from what a camera sees; b1 takes a mesh as it is. `settings` are by default those
        of params.yaml in the current directory, where there is one; and `limits`, what the robot's hands have to keep
        to, those of the settings. Where the folder `data` of the current directory has no nets, or none that know the
        cloth, prebuilt ones are taken, as by the commands.
        """
        cloth = {
            "side": None if side is None else float(side),
            "sides": _floats("sides", sides, 2),
            "thickness": None if thickness is None else float(thickness),
        }
        if settings is None:
            _, settings = load_nets(Path(data), cloth if system == "main" else None)
        else:
            settings = settings._replace(data=Path(data))
        options = observation_options(
            settings.app,
            **cloth,
            table=_floats("table", table, 4),
            table_colour=None if table_colour is None else tuple(table_colour),
            box=_floats("box", box, 6),
            up=_floats("up", up, 3),
            viewpoint=_floats("viewpoint", viewpoint, 3),
        )
        keep_compiled_programs()
        loaded = planner.load_planner(system_of(system), settings.data, settings, optimiser=optimiser)
        self._set(loaded, settings, options, frame, limits)

    @classmethod
    def of(
        cls,
        planner: Planner,
        settings: Settings,
        options: ObservationOptions,
        *,
        frame: Frame = "camera",
        limits: Limits | None = None,
    ) -> "Agent":
        """An agent whose planner is loaded already."""
        made = cls.__new__(cls)
        made._set(planner, settings, options, frame, limits)
        return made

    def _set(
        self,
        planner: Planner,
        settings: Settings,
        options: ObservationOptions,
        frame: Frame,
        limits: Limits | None,
    ) -> None:
        self._planner, self._settings, self._options, self._frame = planner, settings, options, frame
        self._limits = limits_of(settings.app) if limits is None else check_limits(limits)
        self._now: AgentState | None = None
        self._session: Session | None = None
        self._agreements: tuple[EstimateAgreement | None, EstimateAgreement | None] = (None, None)
        self._unlaid: _NamedGoal | None = None

    @property
    def state(self) -> AgentState:
        """All that the agent knows, by value. Raises InputError if no session has begun."""
        if self._now is None:
            raise InputError("agent: no session has begun, expected begin(goal, steps) first")
        return self._now

    @property
    def left(self) -> int:
        """The number of manipulations that are left, without the first one of a plan that was made and waits."""
        return self.state.left

    @property
    def viewport(self) -> Viewport:
        """What voxels that are observed have to cover: what the nets know, by which they tell heights."""
        return self._options.cloud.viewport

    @property
    def agreements(self) -> tuple[EstimateAgreement | None, EstimateAgreement | None]:
        """How far the estimates of the state and of the goal agree with what was observed; None: not estimated."""
        return self._agreements

    def copy(self) -> "Agent":
        """An agent that knows the same and goes its own way from here."""
        return copy.copy(self)

    def begin(
        self,
        goal: Observable,
        steps: int | Literal["auto"] | None = None,
        *,
        turn: Turn | None = None,
        mirror: bool | None = None,
        after: Plan | str | Path | None = None,
    ) -> "Agent":
        """Begin a session: a goal, wherever it lies, and how many manipulations (1 to 3) to reach it in.

        With "auto", the agent chooses anew for each plan how many are worth it, and ends when nothing more is.

        A goal can be a name of `clothkit goals`, such as "half": it is made of the agent's cloth in the simulator and
        lies turned as the cloth lies that is observed first; `turn` (degrees) and `mirror` tell from which side of the
        cloth its folds are made, and `steps` are by default as many as it needs.

        With `after`, a plan whose first step has been executed, the session goes on with what is left of that plan: its
        later steps, its labels and its memory. Returns the agent.
        """
        source = Path(after) if isinstance(after, str | Path) else Path("the plan before")
        previous = read_plan(source) if isinstance(after, str | Path) else after
        name = goal_name(goal, turn, mirror)
        variant, traces, choosing = None, None, None
        if previous is not None:
            if previous.system != self._planner.system.name:
                own = self._planner.system.name
                raise InputError(f"{source}: was planned by system {previous.system}, expected {own}, the agent's")
            cloth_of(previous, {"sides": self._options.sides, "thickness": (self._options.thickness,)}, source)
            check_nets(previous, self._planner, self._settings.data, source)
            traces = traces_before(previous, self._planner, source)
            variant = variant_before(name, previous, source, turn, mirror) if name else None
        if steps == AUTO:
            check_can_choose(self._planner.system)
            length, choosing = STEPS, self._settings.app.length
        else:
            length = _length(steps, name, previous, source)
        if name:
            form = variant or Variant(turn=turn or 0, mirror=bool(mirror))
            wanted = named_goal(name, form, self._options, self._settings)
        else:
            wanted = input_of(goal, self._options, name="goal")
        now = agent_state.begin(self._planner, self._settings, wanted, length, choosing)
        agreement = compare_goal(self._planner.system, wanted, now.target, self._settings)
        if previous is not None and traces is not None:
            if previous.turned and not self._planner.system.voxels:
                now = agent_state.turned(now, np.array(previous.turned))
            now = dataclasses.replace(now, memory=memory_of(previous, self._planner, now.memory, traces, length))
        self._now, self._agreements = now, (None, agreement)
        self._unlaid = _NamedGoal(name, turn, mirror) if name and variant is None else None
        title, cloth = f"{self._planner.system.name}, {wanted.file}", self._options.cloth
        self._session = Session(title, length, now.target, (), (), cloth=cloth)
        return self

    def observe(
        self,
        cloth: Observable,
        *,
        mask: Mask | None = None,
        table: Numbers | None = None,
        up: Numbers | None = None,
        viewpoint: Numbers | None = None,
        executed: bool | None = None,
    ) -> ObservedCloth:
        """Observe the cloth as it lies now, and return what it is taken for.

        `mask`, `table`, `up` and `viewpoint` are of this observation alone, of a camera that moves for example. After a
        plan, `executed` tells whether its first step was carried out. If it was not, the agent has the same number of
        manipulations left as before. By default it was if the plan says that it improves the state; if not, nothing
        was done and the step is used up, as in section 5.1 of the paper.
        """
        before, options = self.state, self._options
        if table is not None:
            # The normal of a table that is given points up.
            options = options._replace(table=plane_of(table), stated=options.stated._replace(up=None))
        stated = Stated(
            _floats("up", up, 3) or options.stated.up, _floats("viewpoint", viewpoint, 3) or options.stated.viewpoint
        )
        source = input_of(cloth, options._replace(stated=stated), name="cloth", mask=mask)
        if before.planned is not None and executed is not False:
            before = agent_state.advanced(before, executed=before.planned.improves if executed is None else True)
        if self._unlaid is not None:
            before = agent_state.with_goal(before, goal_like(source, *self._unlaid, self._options, self._settings))
        now = agent_state.observe(before, source)
        assert now.perceived is not None
        agreement = compare_state(self._planner.system, source, now.perceived.state, self._settings)
        # A cloth that is observed again, with nothing done in between, takes the place of what was seen before.
        again = now.left != self.session.length - len(self.session.states)
        self._session = _with_state(self.session._replace(goal=now.target), now.perceived, replacing=again)
        self._now, self._agreements, self._unlaid = now, (agreement, self._agreements[1]), None
        return self._observed(now.perceived)

    def plan(self, *, seed: int = 0) -> Plan:
        """A plan for the manipulations that are left, from the last observation. The same seed gives the same plan.

        Only its first step is meant to be executed before the next observation.
        """
        now = agent_state.plan(self.state, seed=seed, limits=self._limits)
        assert now.perceived is not None
        assert now.planned is not None
        source = now.perceived.source
        request = PlanRequest(
            source,
            now.goal,
            now.target,
            now.matrix,
            self._options.sides,
            self._options.thickness,
            seed,
            frame_of(source, self._frame),
            self._agreements,
            self._settings,
            std=now.perceived.std,
        )
        paths = paths_of(self._planner, now.planned, source.pose, self._settings.app.motion)
        hands = [hands_of(self._limits, path.points) for path in paths]
        found = describe(self._planner, now.planned, paths, request._replace(limits=self._limits, hands=hands))
        *before, step = self.session.steps
        step = step._replace(plan=shown_plan(self._planner, now.planned, settings=self._settings))
        self._session = self.session._replace(steps=(*before, step), goal=now.target)
        self._now = now
        return found

    @property
    def session(self) -> Session:
        """The session so far, in the form in which the viewer plays sessions; states are as the agent perceived them.

        Raises InputError if none has begun.
        """
        if self._session is None:
            raise InputError("agent: no session has begun, expected begin(goal, steps) first")
        return self._session

    def record(self, path: str | Path) -> None:
        """Write the session so far as a recording of Rerun (.rrd; extra `rerun`). Raises InputError."""
        path = Path(path)
        check_target(path, (ENDING[1:],))
        write_recording(path, self.session, side=self._options.side, motion=self._settings.app.motion)

    def _observed(self, perceived: Perceived) -> ObservedCloth:
        source, state, target = perceived.source, perceived.state, self.state.target
        representation, frame = self._planner.representation, frame_of(source, self._frame)
        pose = source.pose
        if frame == "table":
            pose = Pose(np.eye(3), np.zeros(3), pose.centre, pose.scale)
        grasps = perceived.candidates[np.isfinite(perceived.candidates).all(-1)]
        if self._planner.system.voxels:
            vertices, away = None, float(representation.distance(state[None], target[None])[0])
            places = np.column_stack([grasps, np.zeros(len(grasps))])
        else:
            vertices = pose.normalised_to_camera(state.astype(float))
            away = float(error(state, target, aligned=True, cloth=source.cloth))
            places = np.array([np.asarray(to_cartesian(state, grasp), float) for grasp in grasps]).reshape(-1, 3)
        unsure = unsure_of(source, state, perceived.std, pose)
        told = [*source.notices, *(a.sentence for a in self._agreements[:1] if a is not None and not a.reliable)]
        return ObservedCloth(
            frame=frame,
            centre_m=pose.table_to_camera(np.append(pose.centre, 0.0)),
            vertices_m=vertices,
            grasps_m=pose.normalised_to_camera(places),
            error=away,
            agreement=self._agreements[0],
            notices=(*told, *told_of(Signs(self._agreements[0], unsure=unsure))),
            unsure=unsure,
        )


def _length(steps: int | None, name: str | None, previous: Plan | None, source: Path) -> int:
    """The number of manipulations that are asked for. Raises InputError if it is not 1 to STEPS."""
    if previous is not None:
        return steps_left(previous, source, steps)
    if name and steps is None:
        return manipulations_of(name)
    if steps is None or steps not in range(1, STEPS + 1):
        raise InputError(f"steps: expected 1, 2 or 3 manipulations or {AUTO}, found {steps}")
    return steps


def _with_state(session: Session, perceived: Perceived, *, replacing: bool) -> Session:
    """The session with one more state, or with another last state."""
    states, steps, centres = session.states, session.steps, session.centres
    if replacing:
        states, centres, steps = states[:-1], centres[:-1], steps[: len(states) - 1]
    pose, points = perceived.source.pose, perceived.candidates
    step = Step(StateEstimate(perceived.state, None, points[np.isfinite(points).all(-1)]))
    return session._replace(
        states=(*states, perceived.state),
        centres=(*centres, np.asarray(pose.centre / pose.scale, np.float32)),
        steps=(*steps, step) if len(states) < session.length else steps,
    )


def _floats(name: str, values: Numbers | None, count: int) -> Any:
    """Return a tuple of so many floats, None if nothing is given. Raises InputError for another number of them."""
    if values is None:
        return None
    if len(values) != count:
        raise InputError(f"{name}: expected {count} numbers, found {len(values)}")
    return tuple(float(value) for value in values)
