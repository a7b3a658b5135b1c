"""Batched worlds: cloths that are grasped, moved along paths, released and settled (section 4.2.2)."""

from typing import NamedTuple

import numpy as np
import warp as wp
from jaxtyping import Bool, Float, Int

from clothkit.cloth.grid import CLOTH_SIDE
from clothkit.manipulation.geometry import arc
from clothkit.simulation.kernels.advance import advance
from clothkit.simulation.kernels.state import HELD, PATH
from clothkit.simulation.settings import SimulationConfig
from clothkit.simulation.solver import LANES_ON_CUDA, LAUNCH_SECONDS, make_solver, make_state

RESTED = 1  # the kernels' `done` of a world that came to rest
SPENT = 3  # `done` of a world that was given up here
PATIENCE = 3  # times the steps of a world that goes back, at every search, as often as its guard lets it
MOST_STEPS = 10**6  # of a world, however long it may move and settle
FAR = 1e3  # m; vertices that were listed there make the contact lists stale at once
UNSEARCHED = 2**20  # crossings before the first search: whatever a given state has is not undone
FRESH = (
    *("velocity", "correction", "contacts", "features", "in_bend", "twisted", "pairs", "pressed"),
    *("time", "done", "checked_time", "calm", "residual"),
    *("careful_until", "tries", "returns", "lost", "searched"),
)
"""The kernels' arrays that are zero when a manipulation begins."""


class Motion(NamedTuple):
    """What the hands of some worlds do."""

    held: Int[np.ndarray, "worlds 2 layers"]
    """Vertices that each hand holds, u * side + v, -1 for none. They keep their places relative to the first."""
    path: Float[np.ndarray, "worlds 2 times 3"]
    """Metres, where each hand's first vertex is, at equal times from grasp to release."""
    seconds: Float[np.ndarray, " worlds"]
    """From grasp to release."""


class Outcome(NamedTuple):
    """What became of each world."""

    states: Float[np.ndarray, "worlds u v 3"]
    """Metres, world frame."""
    rested: Bool[np.ndarray, " worlds"]
    """Whether every vertex came to rest in time."""
    residual_speed: Float[np.ndarray, " worlds"]
    """m/s, of the fastest vertex, mean over a check's interval: the highest in the last `rest_time`, else the last."""
    settle_time: Float[np.ndarray, " worlds"]
    """Simulated seconds from release to rest, without the `rest_time` over which rest was watched."""
    spent: Bool[np.ndarray, " worlds"]
    """Whether it was given up because its budget of steps was spent."""


def arcs(
    states: Float[np.ndarray, "worlds u v 3"],
    grasps: Int[np.ndarray, "worlds 2 layers"],
    releases: Float[np.ndarray, "worlds 2 2"],
    settings: SimulationConfig,
) -> Motion:
    """Hands that move by the arcs of section 4.2.2 to the releases xy [m], slow at both ends."""
    vertices = states.reshape(len(states), -1, 3)
    first = np.maximum(grasps[:, :, 0], 0)
    grasped = np.take_along_axis(vertices, first[..., None], axis=1).astype(np.float64)
    lift = settings.highest_lift * settings.cloth_side / CLOTH_SIDE
    path = arc(grasped, np.asarray(releases, np.float64), height_limit=lift)
    held = grasps[:, :, 0] >= 0
    seconds = np.where(held, path.radius * path.angle / settings.hand_speed, 0.0).max(1)
    time = np.linspace(0, 1, int(PATH))
    points = np.stack([path.at(share) for share in time**2 * (3 - 2 * time)], axis=2)
    return Motion(grasps, points, np.maximum(seconds, settings.shortest_move))


class Worlds:
    """Up to `count` worlds on one device. What happens in a world depends on nothing but its own arguments."""

    def __init__(self, count: int, settings: SimulationConfig) -> None:
        self.count, self.settings = count, settings
        self.device = settings.device
        self.lanes = 1 if self.device == "cpu" else LANES_ON_CUDA
        self.solver = make_solver(settings)
        self.state = make_state(count, settings.side, self.device)

    def execute(self, states: Float[np.ndarray, "worlds u v 3"], motion: Motion) -> Outcome:
        """Grasp, move, release, settle.

        States are in metres, world frame, float32. Every contact is found anew from the state, so the same arguments
        give the same outcome to the last bit, whatever the worlds did before and whichever others run beside. A world
        whose budget of steps is spent is left as it lies then.
        """
        worlds = len(states)
        if worlds > self.count:
            raise ValueError(f"{worlds} states for {self.count} worlds")
        if worlds == 0:
            return Outcome(states, *(np.zeros(0, kind) for kind in (bool, np.float32, np.float32, bool)))
        self.begin(states, motion)
        left = self.budget(motion.seconds)
        while not (done := self.read("done", worlds)).all():
            spent = (done == 0) & (left <= 0)
            if spent.any():
                self._write("done", np.where(spent, SPENT, done).astype(np.int32))
                continue
            self.advance(worlds)
            left -= 1
        rested = done == RESTED
        watched = np.where(rested, np.float32(self.settings.settling.rest_time), np.float32(0))
        return Outcome(
            self.read("position", worlds).reshape(states.shape),
            rested,
            self.read("residual", worlds),
            self.read("time", worlds) - self.read("move_time", worlds) - watched,
            done == SPENT,
        )

    def budget(self, seconds: Float[np.ndarray, " worlds"]) -> Int[np.ndarray, " worlds"]:
        """Launches after which a world that moves for so long is given up: none that ends at all needs as many.

        None for motions that are not finite, or that `MOST_STEPS` would not bring to their end.
        """
        dt, settings = self.settings.time_step, self.settings
        ends = np.isfinite(seconds) & (seconds <= MOST_STEPS * dt)
        longest = np.where(ends, seconds, 0.0) + settings.settling.longest
        simulated = np.minimum(PATIENCE * (1 + settings.guard.tries) * longest, MOST_STEPS * dt)
        return np.where(ends, np.ceil(simulated / LAUNCH_SECONDS), 0).astype(int)

    def begin(self, states: Float[np.ndarray, "worlds u v 3"], motion: Motion) -> None:
        """Set the first worlds up for a manipulation each, with nothing left of what they did before."""
        state, worlds = self.state, len(states)
        for name in FRESH:
            getattr(state, name).zero_()
        state.saved_time.fill_(-FAR)
        state.saved_crossings.fill_(UNSEARCHED)
        state.free.fill_(1.0)
        state.list_position.fill_(FAR)
        vertices = np.ascontiguousarray(states, np.float32).reshape(worlds, -1, 3)
        self._write("position", vertices)
        self._write("saved_position", vertices)
        self._write("checked", vertices)
        layers = motion.held.shape[-1]
        held = np.full((worlds, int(HELD)), -1, np.int32)
        held[:, : 2 * layers] = motion.held.reshape(worlds, -1)
        by = np.zeros((worlds, int(HELD)), np.int32)
        by[:, layers : 2 * layers] = 1
        taken = np.take_along_axis(vertices, np.maximum(held, 0)[..., None], axis=1)
        hand = np.take_along_axis(taken, (by * layers)[..., None], axis=1)
        self._write("held", held)
        self._write("held_by", by)
        self._write("held_offset", taken - hand)
        self._write("path", _resampled(motion.path).astype(np.float32))
        self._write("move_time", motion.seconds.astype(np.float32))

    def advance(self, worlds: int) -> None:
        """Advance the first `worlds` that are not done by a launch's substeps."""
        wp.launch(
            advance,
            dim=(worlds, self.lanes),
            inputs=[self.solver, self.state, self.lanes],
            block_dim=self.lanes,
            device=self.device,
        )

    def read(self, name: str, worlds: int) -> np.ndarray:
        """A copy of one of the state's arrays, of the first `worlds`."""
        return getattr(self.state, name).numpy()[:worlds].copy()

    def _write(self, name: str, values: np.ndarray) -> None:
        array = getattr(self.state, name)
        if len(values) < self.count:
            values = np.concatenate([values, array.numpy()[len(values) :]])
        array.assign(values)


def _resampled(path: np.ndarray) -> np.ndarray:
    """Paths at as many equal times as the kernels take, linear in between."""
    times = path.shape[2]
    place = np.linspace(0, times - 1, int(PATH))
    low = np.minimum(place.astype(int), times - 2)
    share = (place - low)[:, None]
    return path[:, :, low] * (1 - share) + path[:, :, low + 1] * share
