"""Sessions as recordings of Rerun (extra `rerun`): what the viewer plays, in metres, state by state.

Timeline `state` counts the executed manipulations; timeline `time` [s] runs while hands move. Entities:

goal                               the goal, where the cloth first lay
cloth, estimate                    the true state, and what it was taken for
estimate/candidates                grasp points that the plan may start with
predicted/net_N/after_K            what net N predicts after step K of the plan
../hand_1, ../hand_2               below a cloth, the paths of the hands in the manipulation that is planned for it
hand_1, hand_2                     where the hands are, waypoint by waypoint of the plan's first manipulation
facts, error, loss                 what the page tells of the state and its plan
"""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from clothkit.app.extras import optional
from clothkit.app.viewer import colours
from clothkit.app.viewer.scene import Shown, cubes, hand_paths, on_top, to_show
from clothkit.app.viewer.session import Session, State, error_of, facts, is_mesh, places
from clothkit.cloth.topology import CLOTH_LENGTH, triangles
from clothkit.cloth.voxels import HEIGHT, RESOLUTION
from clothkit.manipulation.vector import is_null
from clothkit.observation.pose import Pose
from clothkit.observation.waypoints import MotionConfig, paths_from
from clothkit.runtime.publish import unfinished

ENDING = ".rrd"


def write_recording(path: Path, session: Session, *, side: float, motion: MotionConfig) -> None:
    """Write a session of a cloth with that longer side [m] as a whole or not at all. Raises InputError."""
    rerun = optional("rerun", "rerun")
    with unfinished(path) as part:
        stream = rerun.RecordingStream("clothkit")
        stream.save(str(part))
        try:
            _Writer(rerun, stream, session, side / CLOTH_LENGTH, motion).write()
            stream.flush()
        finally:
            stream.disconnect()


class _Writer:
    def __init__(self, rerun: Any, stream: Any, session: Session, scale: float, motion: MotionConfig) -> None:
        self._rerun, self._stream, self._session, self._scale, self._motion = rerun, stream, session, scale, motion
        self._seconds = 0.0

    def write(self) -> None:
        session, rerun = self._session, self._rerun
        self._stream.log("/", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._state("goal", session.goal, self._at(0), colours.GHOST, static=True)
        for at in range(len(session.states)):
            self._stream.set_time("state", sequence=at)
            self._stream.set_time("time", duration=self._seconds)
            self._log_state(at)
            self._log_motion(at)

    def _at(self, at: int) -> Float[np.ndarray, "3"]:
        """Where the cloth's centre lies on the table in a state [m]."""
        centres = self._session.centres
        return np.append(centres[at] * self._scale if at < len(centres) else np.zeros(2), 0.0)

    def _log_state(self, at: int) -> None:
        session, rerun, stream = self._session, self._rerun, self._stream
        for entity in ("estimate", "predicted", "cloth", "hand_1", "hand_2"):
            stream.log(entity, rerun.Clear(recursive=True))
        for shown in to_show(session, at):
            entity, colour = self._named(shown, at)
            self._state(entity, shown.state, self._at(at), colour)
            self._log_hands(entity, shown, self._at(at))
            if shown.candidates is not None and len(shown.candidates) and entity == "estimate":
                points = on_top(shown.state, places(shown.state, shown.candidates)) * self._scale + self._at(at)
                dots = rerun.Points3D(points, colors=_bytes(colours.CANDIDATE), radii=0.012 * self._scale)
                stream.log(f"{entity}/candidates", dots)
        stream.log("facts", rerun.TextDocument(facts(session, at), media_type="text/markdown"))
        off = error_of(session.states[at], session.goal, session.cloth)
        if off is not None:
            stream.log("error", rerun.Scalars(off))
        plan = session.steps[at].plan if at < len(session.steps) else None
        if plan is not None:
            stream.log("loss", rerun.Scalars(plan.loss))

    def _named(self, shown: Shown, at: int) -> tuple[str, colours.Colour]:
        if shown.row == 0:
            return ("estimate", colours.UNKNOWN) if shown.name == "estimate" else ("cloth", colours.FRONT)
        plan = self._session.steps[at].plan
        assert plan is not None
        return f"predicted/net_{plan.members[shown.row - 1]}/after_{shown.column + 1}", colours.BACK

    def _state(
        self, entity: str, state: State, at: Float[np.ndarray, "3"], colour: colours.Colour, *, static: bool = False
    ) -> None:
        rerun = self._rerun
        if is_mesh(state):
            vertices = (state.astype(float) * self._scale + at).reshape(-1, 3)
            shown = rerun.Mesh3D(
                vertex_positions=vertices,
                triangle_indices=triangles(state.shape[:2]),
                albedo_factor=_bytes(colour),
            )
        else:
            boxes = cubes(state, np.zeros(3, np.float32))
            size = np.array([1 / RESOLUTION[0], 1 / RESOLUTION[1], HEIGHT / RESOLUTION[2] / 2]) * self._scale
            shown = rerun.Boxes3D(
                centers=boxes.points * self._scale + at,
                half_sizes=np.tile(size, (len(boxes.points), 1)),
                colors=boxes.colours,
            )
        self._stream.log(entity, shown, static=static)

    def _log_hands(self, entity: str, shown: Shown, at: Float[np.ndarray, "3"]) -> None:
        if shown.manipulation is None:
            return
        for number, points in enumerate(hand_paths(shown.state, shown.manipulation), start=1):
            line = self._rerun.LineStrips3D(
                [points * self._scale + at], colors=_bytes(colours.HANDS[number - 1]), radii=0.004 * self._scale
            )
            self._stream.log(f"{entity}/hand_{number}", line)

    def _log_motion(self, at: int) -> None:
        """Move the hands along the first manipulation of the plan; time goes on by as much."""
        steps = self._session.steps
        plan = steps[at].plan if at < len(steps) else None
        if plan is None or bool(is_null(plan.manipulations[0])):
            return
        state, first = steps[at].estimate.state, plan.manipulations[0]
        grasps = np.stack([points[0] for points in hand_paths(state, first)]).astype(float)
        both = grasps if len(grasps) == 2 else np.concatenate([grasps, grasps])
        pose = Pose(np.eye(3), np.zeros(3), self._at(at)[:2], self._scale)
        paths = paths_from(both, first, pose, self._motion)
        for place, seconds in enumerate(paths.times.tolist()):
            self._stream.set_time("time", duration=self._seconds + seconds)
            for number, points in enumerate(paths.points, start=1):
                colour = _bytes(colours.HANDS[number - 1])
                self._stream.log(
                    f"hand_{number}",
                    self._rerun.Points3D(points[place : place + 1], colors=colour, radii=0.02 * self._scale),
                )
        self._seconds += float(paths.times[-1])


def _bytes(colour: colours.Colour) -> list[int]:
    return [round(255 * float(channel)) for channel in colour]
