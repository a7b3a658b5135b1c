"""Batched worlds: cloths that are grasped, moved along arcs, released and settled (section 4.2.2)."""

from typing import NamedTuple

import numpy as np
import warp as wp
from jaxtyping import Bool, Float, Int

from clothkit.cloth.grid import CLOTH_SIDE
from clothkit.manipulation.geometry import arc
from clothkit.simulation.kernels.advance import advance
from clothkit.simulation.kernels.untangling import untangle
from clothkit.simulation.settings import SimulationConfig
from clothkit.simulation.solver import LANES_ON_CUDA, make_solver, make_state

RESTED = 1  # the kernels' `done` of a world that came to rest
SWEEPS = 40
FAR = 1e3  # m; vertices that were listed there make the contact lists stale at once
SLACK = 3e-4  # m, how far past each other untangled parts are pushed


class Outcome(NamedTuple):
    """What became of each world."""

    states: Float[np.ndarray, "worlds u v 3"]
    """Metres, world frame."""
    rested: Bool[np.ndarray, " worlds"]
    """Whether every vertex came to rest in time."""
    residual_speed: Float[np.ndarray, " worlds"]
    """m/s, of the fastest vertex, mean over the last check's interval."""
    settle_time: Float[np.ndarray, " worlds"]
    """Simulated seconds from release to rest."""


class Worlds:
    """Up to `count` worlds on one device. What happens in a world depends on nothing but its own arguments."""

    def __init__(self, count: int, settings: SimulationConfig) -> None:
        self.count, self.settings = count, settings
        self.device = settings.device
        self.lanes = 1 if self.device == "cpu" else LANES_ON_CUDA
        self.solver = make_solver(settings)
        self.state = make_state(count, settings.side, self.device)

    def execute(
        self,
        states: Float[np.ndarray, "worlds u v 3"],
        grasps: Int[np.ndarray, "worlds 2"],
        releases: Float[np.ndarray, "worlds 2 2"],
    ) -> Outcome:
        """Grasp vertices (index u * side + v, -1 for no hand), move them by their arcs to the releases xy [m], settle.

        States are in metres, world frame, float32. Every contact is found anew from the state, so the same arguments
        give the same outcome to the last bit, whatever the worlds did before and whichever others run beside.
        """
        worlds = len(states)
        if worlds > self.count:
            raise ValueError(f"{worlds} states for {self.count} worlds")
        if worlds == 0:
            return Outcome(states, *(np.zeros(0, kind) for kind in (bool, np.float32, np.float32)))
        self.begin(states, grasps, releases)
        self._settle(worlds)
        for _ in range(self.settings.settling.rounds):
            tangled = self._untangle(worlds)
            if not tangled.any():
                break
            self._reopen(tangled)
            self._settle(worlds)
        time = self._read("time", worlds) - self._read("move_time", worlds)
        return Outcome(
            self._read("position", worlds).reshape(states.shape),
            self._read("done", worlds) == RESTED,
            self._read("fastest", worlds) / np.float32(self.settings.settling.check_interval),
            time,
        )

    def begin(
        self,
        states: Float[np.ndarray, "worlds u v 3"],
        grasps: Int[np.ndarray, "worlds 2"],
        releases: Float[np.ndarray, "worlds 2 2"],
    ) -> None:
        """Set the first worlds up for a manipulation each, with nothing left of what they did before."""
        vertices = np.ascontiguousarray(states, np.float32).reshape(len(states), -1, 3)
        self._reset(vertices)
        self._grasp(vertices, grasps, releases)

    def advance(self, worlds: int) -> None:
        """Advance the first `worlds` that are not done by a launch's substeps."""
        wp.launch(
            advance,
            dim=(worlds, self.lanes),
            inputs=[self.solver, self.state, self.lanes],
            block_dim=self.lanes,
            device=self.device,
        )

    def _read(self, name: str, worlds: int) -> np.ndarray:
        return getattr(self.state, name).numpy()[:worlds].copy()

    def _write(self, name: str, values: np.ndarray) -> None:
        array = getattr(self.state, name)
        if len(values) < self.count:
            values = np.concatenate([values, array.numpy()[len(values) :]])
        array.assign(values)

    def _reset(self, vertices: np.ndarray) -> None:
        state = self.state
        for name in ("velocity", "correction", "touching", "contacts", "features", "pairs", "time", "done", "calm"):
            getattr(state, name).zero_()
        state.quad_head.fill_(-1)
        state.feature_head.fill_(-1)
        state.free.fill_(1.0)
        state.list_position.fill_(FAR)
        for name in ("position", "checked"):
            self._write(name, vertices)

    def _grasp(self, vertices: np.ndarray, grasps: np.ndarray, releases: np.ndarray) -> None:
        settings = self.settings
        grasped = np.take_along_axis(vertices, np.maximum(grasps, 0)[..., None], axis=1).astype(np.float64)
        lift = settings.highest_lift * settings.cloth_side / CLOTH_SIDE
        path = arc(grasped, np.asarray(releases, np.float64), height_limit=lift)
        held = grasps >= 0
        seconds = np.where(held, path.radius * path.angle / settings.hand_speed, 0.0).max(1)
        direction = np.concatenate([path.direction, np.zeros((*held.shape, 1))], axis=-1)
        self._write("hand_vertex", grasps.astype(np.int32))
        self._write("hand_start", path.start.astype(np.float32))
        self._write("hand_direction", direction.astype(np.float32))
        self._write("hand_radius", path.radius.astype(np.float32))
        self._write("hand_angle", path.angle.astype(np.float32))
        self._write("move_time", np.maximum(seconds, settings.shortest_move).astype(np.float32))

    def _settle(self, worlds: int) -> None:
        while not self._read("done", worlds).all():
            self.advance(worlds)

    def _untangle(self, worlds: int) -> np.ndarray:
        """Part what is tangled, and return which worlds had anything tangled."""
        wp.launch(
            untangle, dim=worlds, inputs=[self.solver, self.state, SWEEPS, SLACK], block_dim=1, device=self.device
        )
        return self._read("pierced", worlds)[:, 0] > 0

    def _reopen(self, tangled: np.ndarray) -> None:
        """Let the untangled worlds settle again, from half a second after release."""
        worlds = len(tangled)
        release = self._read("move_time", worlds)
        time = np.minimum(self._read("time", worlds), release + np.float32(0.5))
        changes: dict[str, float] = {
            "done": 0,
            "calm": 0,
            "velocity": 0,
            "contacts": 0,
            "pairs": 0,
            "list_position": FAR,
        }
        for name, value in changes.items():
            array = self._read(name, worlds)
            array[tangled] = value
            self._write(name, array)
        self._write("time", np.where(tangled, time, self._read("time", worlds)))
        checked = self._read("checked", worlds)
        checked[tangled] = self._read("position", worlds)[tangled]
        self._write("checked", checked)
