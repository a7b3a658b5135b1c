"""The environment: an episode is a cloth that is folded into a goal, manipulation by manipulation, in the simulator."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import gymnasium
import jax
import numpy as np
from gymnasium import spaces
from jaxtyping import Float, UInt8

from clothkit.cloth.mesh import error
from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE
from clothkit.cloth.voxels import double
from clothkit.environment.goals import Mesh, MeshSampler, RandomFolds, drawn
from clothkit.environment.observations import Observer
from clothkit.manipulation.geometry import to_cartesian
from clothkit.manipulation.vector import SHORTEST
from clothkit.observation.camera import CameraConfig
from clothkit.report.draw import draw
from clothkit.runtime.errors import InputError
from clothkit.simulation.executor import perform
from clothkit.simulation.settings import SimulationConfig
from clothkit.simulation.world import Worlds

Measure = Callable[[Mesh, Mesh], float]
"""mesh, goal (both normalised, centred) -> how far the mesh is from the goal; 0: it is the goal"""

GOAL_TABLE = (0.85, 0.93, 1.0)
"""Colour of the table in pictures of the goal."""


class FoldEnv(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    """Fold a cloth into a goal with two hands; lengths are cloth lengths, the cloth's longer side is 1.

    An action is a manipulation: two grasp points and a displacement dx dy, each in -1..1. Grasp points are places on
    the cloth (`grasps` "cloth": geodesic u1 v1 u2 v2) or on the table below it ("table": x1 y1 x2 y2, from where the
    flat cloth's middle was); a hand takes the topmost vertex near its point. Two equal points are one hand. A
    displacement shorter than 0.35 is no manipulation, and nothing is done (section 4.4).

    An observation is of the kind `observation` (see `observations`), of cloth and goal, with the number of
    manipulations that are left. The reward is the decrease of the measure, by default the error of planning outcomes
    (section 6.3) [cloth length]. An episode terminates when the measure is at most `tolerance`, and is truncated
    after `steps` manipulations.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 2}  # noqa: RUF012

    def __init__(
        self,
        *,
        goal: Mesh | MeshSampler | None = None,
        start: Mesh | MeshSampler | None = None,
        steps: int = 3,
        observation: str = "vertices",
        grasps: str | None = None,
        measure: Measure | None = None,
        tolerance: float = 0.02,
        simulation: SimulationConfig | None = None,
        camera: CameraConfig | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Goals and starts are meshes [normalised] or draw them.

        By default a goal is what one to `steps` random folds make of the flat cloth, and the start is the flat cloth.
        Grasp points are by default on the cloth if its vertices are observed, else on the table. Raises InputError.
        """
        if steps < 1:
            raise InputError(f"steps: expected at least 1, found {steps}")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f"render_mode: expected rgb_array or None, found {render_mode!r}")
        grasps = grasps or ("cloth" if observation == "vertices" else "table")
        if grasps not in ("cloth", "table"):
            raise InputError(f"grasps: expected cloth or table, found {grasps!r}")
        self.render_mode = render_mode
        self._steps, self._grasps, self._tolerance = steps, grasps, tolerance
        simulation = simulation or SimulationConfig()
        self._worlds = Worlds(1, simulation)
        self._topology = self._worlds.topology
        self._goals = goal if goal is not None else RandomFolds(1, steps, self._worlds)
        self._starts = start if start is not None else self._topology.flat()
        self._measure = measure or partial(_error, topology=self._topology)
        # A manipulation moves a cloth by less than two of its lengths.
        farthest = 1.0 + 2.0 * steps
        self._observer = Observer(
            observation,
            self._topology,
            camera=camera or CameraConfig(),
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
        self._goal = self._topology.flat()
        self._left, self._distance, self._distance_start = 0, np.nan, np.nan

    @property
    def mesh(self) -> Mesh:
        """The cloth at its place on the table [normalised]: the truth, whatever is observed."""
        return self._mesh

    @property
    def goal(self) -> Mesh:
        """The goal, centred [normalised]."""
        return self._goal

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode. `options` may hold a `goal` and a `start` of its own. Raises InputError."""
        super().reset(seed=seed)
        if unknown := set(options or {}) - {"goal", "start"}:
            raise InputError(f"options: has {min(unknown)}, expected goal or start")
        chosen = {"start": self._starts, "goal": self._goals, **(options or {})}
        shape = self._topology.shape
        self._mesh = drawn(chosen["start"], self.np_random, shape, name="start")
        self._goal = centred(drawn(chosen["goal"], self.np_random, shape, name="goal"))[0]
        self._left = self._steps
        self._distance = self._distance_start = self._away()
        return self._observation(), self._info(null=False, failed=False)

    def step(self, action: Float[np.ndarray, "6"]) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Execute a manipulation, if any is left. A manipulation whose outcome is not finite changes nothing."""
        if not self._left:
            raise InputError("environment: no manipulation is left, expected reset()")
        # Of the precision of recorded manipulations, so that one of these has its recorded outcome.
        displacement = (np.asarray(action[4:], np.float64) * CLOTH_LENGTH).astype(np.float32)
        null, failed, before = bool(np.linalg.norm(displacement) < SHORTEST), False, self._distance
        if not null:
            outcome = self._executed(self._grasp_points(action), displacement)
            failed = outcome is None
            self._mesh = self._mesh if outcome is None else outcome
        self._left -= 1
        self._distance = self._away()
        terminated = self._distance <= self._tolerance
        info = self._info(null=null, failed=failed)
        return self._observation(), before - self._distance, terminated, not self._left, info

    def render(self) -> UInt8[np.ndarray, "row column 3"] | None:  # type: ignore[override]
        """The goal at the left, the cloth at the right, from above; None without a `render_mode`."""
        if self.render_mode is None:
            return None
        pictures = [draw(_fine(self._goal), table=GOAL_TABLE), draw(_fine(centred(self._mesh)[0]))]
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

    def _away(self) -> float:
        return float(self._measure(centred(self._mesh)[0], self._goal))

    def _observation(self) -> dict[str, np.ndarray]:
        goal = {_of_goal(name): part for name, part in self._observer(self._goal).items() if name != "centre"}
        return {**self._observer(self._mesh), **goal, "left": np.array([self._left], np.int32)}

    def _info(self, *, null: bool, failed: bool) -> dict[str, Any]:
        return {
            "error": self._distance,
            "error_start": self._distance_start,
            "is_success": self._distance <= self._tolerance,
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


def _error(mesh: Mesh, goal: Mesh, *, topology: Any) -> float:
    return float(_aligned(mesh, goal, topology=topology))


_aligned = jax.jit(partial(error, aligned=True), static_argnames="topology")
