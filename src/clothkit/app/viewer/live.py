"""A session that is made while one looks: a plan is searched for, its first step is simulated, and so on.

As in `planning.session`, with two differences: a person says when, and what is not expected to improve the state is
executed all the same when asked for.
What is simulated of a file that holds no mesh is the estimate: one that is tangled is simulated for long.
"""

import dataclasses
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothkit.app.given import Seen, Settings
from clothkit.app.planner import (
    Believed,
    Past,
    Planned,
    believed,
    disagreement,
    estimated,
    goal_of,
    mesh_of,
    traces_after,
    vtm_of,
)
from clothkit.app.viewer.session import Look, Mesh, Session, ShownPlan, Step, error_of, matched
from clothkit.app.viewer.watched import Progress, Watch, find_watched
from clothkit.cloth.grid import CLOTH_SIDE
from clothkit.cloth.silhouette import centred
from clothkit.errors import InputError
from clothkit.manipulation.vector import is_null, is_single
from clothkit.observation.observe import observe
from clothkit.observation.states import MeshState
from clothkit.planning.planner import Planner
from clothkit.simulation.executor import execute


@dataclasses.dataclass(frozen=True)
class Live:
    """A session under way, and what its next plan starts from."""

    session: Session
    planner: Planner
    data: Path
    settings: Settings
    centre: Float[np.ndarray, "2"]
    """Where the cloth's centre is on the table [normalised]."""
    goal: Believed
    """As the system takes it."""
    look: Look
    """What the system takes the current state for, in the labels of its own."""
    past: Past | None = None
    planned: Planned | None = None
    """The plan that waits to be executed."""

    @property
    def at(self) -> int:
        """How many manipulations are behind."""
        return len(self.session.states) - 1

    @property
    def left(self) -> int:
        """How many are left."""
        return self.session.length - self.at


def begin(
    planner: Planner, start: Seen, goal: Seen, length: int, *, title: str, data: Path, settings: Settings
) -> Live:
    """A session of `length` manipulations, before its first plan.

    What is simulated is the mesh that the file holds, or else the estimate. Raises InputError when the files do not
    hold what the system plans from.
    """
    system = planner.system
    look = look_at(planner, start, data, settings)
    truth = mesh_of(start)
    if truth is None:
        truth = look.estimate
        if system.voxels:
            truth = np.asarray(estimated(vtm_of(data, settings), start, settings).mesh[0])
    wanted = goal_of(system, goal, data, settings)
    mesh = mesh_of(goal)
    shown = Session(title, length, wanted if mesh is None else mesh, (truth,), (matched(Step(look), truth),))
    centre = np.asarray(start.pose.centre / start.pose.scale, np.float32)
    return Live(shown, planner, data, settings, centre, wanted, look)


def look_at(planner: Planner, seen: Seen, data: Path, settings: Settings, *, past: Past | None = None) -> Look:
    """What the system takes a cloth for, with how sure it is where an estimate is refined. Raises InputError."""
    system, expected = planner.system, past.expected if past else None
    if system.voxels or system.true_meshes or not system.refine:
        state, sigma = believed(system, seen, data, settings, expected=expected), None
    else:
        found = estimated(vtm_of(data, settings), seen, settings, expected=expected)
        state, sigma = np.asarray(found.mesh[0]), np.asarray(found.probabilistic.std[0])
    return Look(state, sigma, planner.sight.grasps(state, planner.grasping))


def plan(live: Live, *, seed: int, watch: Watch) -> Live:
    """The session with a plan for the manipulations that are left. Raises InputError when none is."""
    if not live.left:
        raise InputError("session: is over, expected manipulations that are left to plan")
    progress = find_watched(
        live.planner, live.look.estimate, live.goal, live.left, seed=seed, watch=watch, past=live.past
    )
    return with_progress(live, progress)


def with_progress(live: Live, progress: Progress) -> Live:
    """The session with the best plan so far of a search."""
    best = progress.best
    if best is None:
        return dataclasses.replace(live, planned=None, session=_with_step(live.session, Step(live.look)))
    sight = live.planner.sight
    sigmas = None
    if not live.planner.system.voxels:
        sigmas = np.stack([np.asarray(prediction.std) for prediction in best.predictions])
    shown = ShownPlan(
        manipulations=best.plan,
        means=np.stack([sight.means(prediction) for prediction in best.predictions]),
        sigmas=sigmas,
        uncertainty=disagreement(live.planner, best),
        loss=best.loss,
        progress=progress.lowest,
        tried=progress.tried,
    )
    return dataclasses.replace(live, planned=best, session=_with_step(live.session, Step(live.look, shown)))


def _with_step(session: Session, step: Step) -> Session:
    """The session with its last step in place of what was there."""
    return session._replace(steps=(*session.steps[:-1], matched(step, session.states[-1])))


def perform(live: Live) -> Live:
    """The session after the first manipulation of its plan, simulated. A null manipulation changes nothing.

    Raises InputError when there is no plan or the outcome is not finite.
    """
    planned = live.planned
    if planned is None:
        raise InputError("session: has no plan, expected one to execute")
    null = bool(is_null(planned.plan[0]))
    truth, centre = (live.session.states[-1], live.centre) if null else _simulated(live, planned.plan[0])
    past = Past(planned.state, planned.traces, planned.relative, planned.plan[1:])
    if not null:
        better = live.planner.better
        expected = np.asarray(live.planner.sight.means(planned.predictions[better])[0], np.float32)
        past = past._replace(expected=expected, traces=traces_after(live.planner, planned))
    look = live.look
    session = live.session._replace(states=(*live.session.states, truth), steps=_noted(live, null, truth))
    if not session.over:
        if not null:
            look = look_at(live.planner, _seen(truth, centre, live.settings), live.data, live.settings, past=past)
        session = session._replace(steps=(*session.steps, matched(Step(look), truth)))
    return dataclasses.replace(live, session=session, centre=centre, look=look, past=past, planned=None)


def _noted(live: Live, null: bool, outcome: Mesh) -> tuple[Step, ...]:
    *before, step = live.session.steps
    assert step.plan is not None
    after = error_of(outcome, live.session.goal)
    note = "its first manipulation is too short to be executed: nothing was done" if null else "executed"
    note += "" if after is None else f", error after it **{after:.3f}**"
    return (*before, step._replace(plan=step.plan._replace(note=note)))


def _simulated(live: Live, manipulation: Float[np.ndarray, "6"]) -> tuple[Mesh, Float[np.ndarray, "2"]]:
    mesh = live.session.states[-1] + np.append(live.centre, 0).astype(np.float32)
    places = live.planner.sight.places(live.look.estimate[None], manipulation[None, :4].reshape(1, 2, 2))
    run = partial(execute, settings=live.settings.simulation, workers=1)
    outcome = run(
        mesh[None],
        (places + live.centre).astype(np.float32),
        manipulation[None, 4:],
        np.asarray(is_single(manipulation[None])),
    )[0]
    if not np.isfinite(outcome).all():
        raise InputError("session: the manipulation has an outcome that is not finite")
    return centred(outcome)


def _seen(truth: Mesh, centre: Float[np.ndarray, "2"], settings: Settings) -> Seen:
    """What a camera sees of the simulated cloth."""
    state = MeshState(truth, centre, settings.app.side / CLOTH_SIDE)
    return Seen("simulation", state, observe(state, cloth_side=settings.app.side, settings=settings.app.cloud))
