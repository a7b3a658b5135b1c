"""The environment: an episode is a cloth that is folded into a goal, manipulation by manipulation, in the simulator."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from jaxtyping import Float, UInt8

from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE
from clothkit.cloth.voxels import VIEWPORT, Viewport, double
from clothkit.dataset.store import STEPS
from clothkit.environment.goals import Goal, Mesh, Start, Target, needed, start_mesh, target_of
from clothkit.environment.observations import Observer
from clothkit.evaluation.errors import errors
from clothkit.goals.rows import measured
from clothkit.goals.store import user_folder
from clothkit.manipulation.geometry import to_cartesian
from clothkit.manipulation.vector import SHORTEST
from clothkit.observation.camera import CameraConfig
from clothkit.report.draw import draw
from clothkit.runtime.errors import InputError
from clothkit.simulation.executor import perform
from clothkit.simulation.settings import SimulationConfig
from clothkit.simulation.world import Worlds

Measure = str | Callable[[Mesh, Mesh], float]
"""How far a cloth is from the goal: softgym, error, or a function of mesh and goal, both normalised and centred."""

GOAL_TABLE = (0.85, 0.93, 1.0)
"""Colour of the table in pictures of the goal."""


class Found(NamedTuple):
    """How far the cloth is from the goal."""

    error: float
    """[cloth length]"""
    measure: float
    """That of which the reward is the decrease."""


class FoldEnv(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    """Fold a cloth into a goal with two hands; lengths are cloth lengths, the cloth's longer side is 1.

    An action is a manipulation: two grasp points and a displacement dx dy, each in -1..1. Grasp points are places on
    the cloth (`grasps` "cloth": geodesic u1 v1 u2 v2) or on the table below it ("table": x1 y1 x2 y2, from where the
    flat cloth's middle was); a hand takes the topmost vertex near its point. Two equal points are one hand. A
    displacement shorter than 0.35 is no manipulation, and nothing is done (section 4.4).

    An observation is of the kind `observation` (see `observations`), of cloth and goal, with the number of
    manipulations that are left. The reward is the decrease of the `measure`: of a named goal SoftGym's
    (`goals.measures.softgym`), else the error of planning outcomes (section 6.3) [cloth length]. An episode terminates
    when the error is at most `tolerance`, and is truncated after `steps` manipulations.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 2}  # noqa: RUF012

    def __init__(
        self,
        *,
        goal: Goal = "half",
        start: Start | None = None,
        steps: int | None = None,
        observation: str = "vertices",
        grasps: str | None = None,
        measure: Measure | None = None,
        tolerance: float = 0.02,
        simulation: SimulationConfig | None = None,
        camera: CameraConfig | None = None,
        viewport: Viewport = VIEWPORT,
        goals_folder: Path | None = None,
        render_mode: str | None = None,
    ) -> None:
        """A goal is a mesh [normalised], what draws one, or a name or several (`clothkit goals`).

        A start is a mesh, what draws one, or the name of a way in which cloths lie at random: flat, dragged, crumpled;
        by default the cloth lies flat and straight. There are by default one more of `steps` than a named goal needs,
        else 3. Grasp points are by default on the cloth if its vertices are observed, else on the table. `viewport` is
        that of observed voxels, by default the paper's: nets that read them need their own (`Agent.viewport`). Named
        goals, which are made in the simulator, are kept in `goals_folder` (default: the user's cache). Raises
        InputError.
        """
        if steps is None:
            least = needed(goal)
            steps = STEPS if least is None else least + 1
        if steps < 1:
            raise InputError(f"steps: expected at least 1, found {steps}")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f"render_mode: expected rgb_array or None, found {render_mode!r}")
        grasps = grasps or ("cloth" if observation == "vertices" else "table")
        if grasps not in ("cloth", "table"):
            raise InputError(f"grasps: expected cloth or table, found {grasps!r}")
        if not (measure is None or measure in ("softgym", "error") or callable(measure)):
            raise InputError(f"measure: expected softgym, error, or a function of mesh and goal, found {measure!r}")
        self.render_mode = render_mode
        self._steps, self._grasps, self._tolerance = steps, grasps, tolerance
        simulation = simulation or SimulationConfig()
        self._worlds = Worlds(1, simulation)
        self._topology = self._worlds.topology
        self._goals, self._starts, self._measure = goal, self._topology.flat() if start is None else start, measure
        self._folder, self._viewport = goals_folder or user_folder(), viewport
        # A manipulation moves a cloth by less than two of its lengths.
        farthest = 1.0 + 2.0 * steps
        self._observer = Observer(
            observation,
            self._topology,
            camera=camera or CameraConfig(),
            viewport=viewport,
            side=simulation.cloth_side,
            farthest=farthest,
        )
        parts = self._observer.spaces()
        self.observation_space = spaces.Dict(  # type: ignore[assignment]
            {
                **parts,
                **{_of_goal(name): space for name, space in parts.items() if name != "centre"},
                "left": spaces.Box(0, steps, (1,), np.int32),
            }
        )
        self.action_space = spaces.Box(-1, 1, (6,), np.float32)
        self._mesh = self._topology.flat()
        self._target = Target(self._topology.flat(), None)
        self._left, self._found, self._found_start = 0, Found(np.nan, np.nan), Found(np.nan, np.nan)

    @property
    def mesh(self) -> Mesh:
        """The cloth at its place on the table [normalised]: the truth, whatever is observed."""
        return self._mesh

    @property
    def viewport(self) -> Viewport:
        """What the observed voxels cover."""
        return self._viewport

    @property
    def goal(self) -> Mesh:
        """The goal, centred [normalised]."""
        return self._target.mesh

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode. `options` may hold a `goal` and a `start` of its own. Raises InputError."""
        super().reset(seed=seed)
        if unknown := set(options or {}) - {"goal", "start"}:
            raise InputError(f"options: has {min(unknown)}, expected goal or start")
        chosen: dict[str, Any] = {"start": self._starts, "goal": self._goals, **(options or {})}
        world = (self.np_random, self._worlds.settings, self._topology)
        start = start_mesh(chosen["start"], *world)
        target = target_of(chosen["goal"], start, *world, folder=self._folder)
        if self._measure == "softgym" and target.problem is None:
            raise InputError("measure: softgym is of named goals, but the goal is a mesh; expected error or a function")
        self._mesh, self._target, self._left = start, target, self._steps
        self._found = self._found_start = self._measured()
        return self._observation(), self._info(null=False, failed=False)

    def step(self, action: Float[np.ndarray, "6"]) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Execute a manipulation, if any is left. A manipulation whose outcome is not finite changes nothing."""
        if not self._left:
            raise InputError("environment: no manipulation is left, expected reset()")
        # Of the precision of recorded manipulations, so that one of these has its recorded outcome.
        displacement = (np.asarray(action[4:], np.float64) * CLOTH_LENGTH).astype(np.float32)
        null, failed, before = bool(np.linalg.norm(displacement) < SHORTEST), False, self._found.measure
        if not null:
            outcome = self._executed(self._grasp_points(action), displacement)
            failed = outcome is None
            self._mesh = self._mesh if outcome is None else outcome
        self._left -= 1
        self._found = self._measured()
        info = self._info(null=null, failed=failed)
        return self._observation(), before - self._found.measure, info["is_success"], not self._left, info

    def render(self) -> UInt8[np.ndarray, "row column 3"] | None:  # type: ignore[override]
        """The goal at the left, the cloth at the right, from above; None without a `render_mode`."""
        if self.render_mode is None:
            return None
        pictures = [draw(_fine(self.goal), table=GOAL_TABLE), draw(_fine(centred(self._mesh)[0]))]
        return np.concatenate(pictures, axis=1)

    def _grasp_points(self, action: Float[np.ndarray, "6"]) -> Float[np.ndarray, "2 2"]:
        """Grasp points on the table [normalised]."""
        points = np.asarray(action[:4], np.float32).reshape(2, 2)
        if self._grasps == "table":
            return points * CLOTH_LENGTH
        return np.stack([np.asarray(to_cartesian(self._mesh, point))[:2] for point in points])

    def _executed(self, grasps: Float[np.ndarray, "2 2"], displacement: Float[np.ndarray, "2"]) -> Mesh | None:
        scale = self._worlds.settings.cloth_side / CLOTH_LENGTH
        states = (self._mesh.astype(np.float64) * scale).astype(np.float32)
        single = np.array([bool((grasps[0] == grasps[1]).all())])
        _, outcome = perform(
            self._worlds,
            states[None],
            (grasps.astype(np.float64) * scale)[None],
            (displacement.astype(np.float64) * scale)[None],
            single,
        )
        found = (outcome.states[0].astype(np.float64) / scale).astype(np.float32)
        return found if np.isfinite(found).all() else None

    def _measured(self) -> Found:
        mesh, problem, measure = centred(self._mesh)[0], self._target.problem, self._measure
        if problem is None:
            found = {"error": float(errors(mesh[None], self.goal[None], aligned=True, topology=self._topology)[0])}
        else:
            found = measured(problem, self._mesh, problem.flattened)
        if callable(measure):
            return Found(found["error"], float(measure(mesh, self.goal)))
        return Found(found["error"], found[measure or ("error" if problem is None else "softgym")])

    def _observation(self) -> dict[str, np.ndarray]:
        goal = {_of_goal(name): part for name, part in self._observer(self.goal).items() if name != "centre"}
        return {**self._observer(self._mesh), **goal, "left": np.array([self._left], np.int32)}

    def _info(self, *, null: bool, failed: bool) -> dict[str, Any]:
        return {
            **self._found._asdict(),
            **{f"{name}_start": value for name, value in self._found_start._asdict().items()},
            "goal_name": None if self._target.problem is None else self._target.problem.name,
            "is_success": self._found.error <= self._tolerance,
            "null": null,
            "failed": failed,
        }


def _of_goal(name: str) -> str:
    return "goal" if name == "cloth" else f"goal_{name}"


def _fine(mesh: Mesh) -> Float[np.ndarray, "fine_u fine_v 3"]:
    """The mesh on a grid that is fine enough to be drawn without holes."""
    while min(mesh.shape[:2]) < SQUARE.shape[0]:
        mesh = np.asarray(double(mesh))
    return mesh
