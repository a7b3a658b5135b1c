"""Batched worlds: cloths that are grasped, moved along paths, released and settled (section 4.2.2)."""

from typing import NamedTuple

import numpy as np
import warp as wp
from jaxtyping import Bool, Float, Int

from clothkit.cloth.topology import CLOTH_LENGTH, Topology
from clothkit.manipulation.geometry import arc
from clothkit.simulation.kernels.advance import advance
from clothkit.simulation.kernels.state import HELD, PATH
from clothkit.simulation.settings import SimulationConfig
from clothkit.simulation.solver import LAUNCH_SECONDS, make_solver, make_state

RESTED = 1  # the kernels' `done` of a world that came to rest
SPENT = 3  # the value of `done` for a world whose budget of steps is spent
PATIENCE = 3  # factor of the budget over the steps of a world that its guard resets as often as possible
MOST_STEPS = 10**6  # the most steps of a world, for any motion and settling time
FAR = 1e3  # m, an initial `list_position` so far away that the contact lists are stale at once
UNSEARCHED = 2**20  # initial `saved_crossings`, so large that crossings of the initial state are not undone
FRESH = (
    *("velocity", "contacts", "features", "in_bend", "twisted", "pairs", "pressed"),
    *("time", "done", "checked_time", "calm", "residual"),
    *("careful_until", "tries", "returns", "lost", "searched"),
)
"""The kernels' arrays that are set to zero before a manipulation."""


class Motion(NamedTuple):
    """The motions of the hands in a batch of worlds."""

    held: Int[np.ndarray, "worlds 2 layers"]
    """Vertices that each hand holds, numbered row by row, -1 for none. Their offsets from the first stay fixed."""
    path: Float[np.ndarray, "worlds 2 times 3"]
    """Positions of each hand's first vertex at equal time steps from grasp to release, in metres."""
    seconds: Float[np.ndarray, " worlds"]
    """Duration from grasp to release, in s."""


class Outcome(NamedTuple):
    """The result of a manipulation in each world."""

    states: Float[np.ndarray, "worlds u v 3"]
    """Metres, world frame."""
    rested: Bool[np.ndarray, " worlds"]
    """Whether every vertex came to rest in time."""
    residual_speed: Float[np.ndarray, " worlds"]
    """Speed of the fastest vertex, in m/s, as a mean over a check's interval.

    For a world at rest it is the highest over the last `rest_time`, otherwise the last one."""
    settle_time: Float[np.ndarray, " worlds"]
    """Simulated time from release to rest, in s, without the `rest_time` over which rest was checked."""
    spent: Bool[np.ndarray, " worlds"]
    """Whether the world was given up because its budget of steps was spent."""


def arcs(
    states: Float[np.ndarray, "worlds u v 3"],
    grasps: Int[np.ndarray, "worlds 2 layers"],
    releases: Float[np.ndarray, "worlds 2 2"],
    settings: SimulationConfig,
) -> Motion:
    """Return hand motions along the arcs of section 4.2.2 to the release points xy in metres, slow at both ends."""
    vertices = states.reshape(len(states), -1, 3)
    first = np.maximum(grasps[:, :, 0], 0)
    grasped = np.take_along_axis(vertices, first[..., None], axis=1).astype(np.float64)
    lift = settings.highest_lift * settings.cloth_side / CLOTH_LENGTH
    path = arc(grasped, np.asarray(releases, np.float64), height_limit=lift)
    held = grasps[:, :, 0] >= 0
    seconds = np.where(held, path.radius * path.angle / settings.hand_speed, 0.0).max(1)
    time = np.linspace(0, 1, int(PATH))
    points = np.stack([path.at(share) for share in time**2 * (3 - 2 * time)], axis=2)
    return Motion(grasps, points, np.maximum(seconds, settings.shortest_move))


class Worlds:
    """Up to `count` worlds. A world's outcome depends only on its own arguments.

    All cloths have the given topology; without one, they are the square of `settings`. Raises ValueError for a grid
    that the solver can't simulate.
    """

    def __init__(self, count: int, settings: SimulationConfig, topology: Topology | None = None) -> None:
        self.count, self.settings = count, settings
        self.topology = topology or settings.topology
        self.solver = make_solver(settings, self.topology)
        self.state = make_state(count, self.topology.shape)

    def execute(self, states: Float[np.ndarray, "worlds u v 3"], motion: Motion) -> Outcome:
        """Simulate grasp, motion, release and settling in each world, and return the outcome.

        States are in metres, in the world frame, float32. All contacts are computed from the initial state, so the same
        arguments give the same outcome to the last bit, independently of earlier calls and of the other worlds. For a
        world whose budget of steps is spent, the state at that time is returned. Raises ValueError for more states than
        worlds, and for states of another number of vertices.
        """
        worlds = len(states)
        if worlds > self.count:
            raise ValueError(f"{worlds} states for {self.count} worlds")
        if states.shape[1:3] != self.topology.shape:
            raise ValueError(f"states of {states.shape[1:3]} vertices for worlds of {self.topology.shape}")
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
        """Return the number of launches after which a world is given up, from the duration of its motion in s.

        The number is well above what a world that comes to rest needs. It is 0 for motions that are not finite or that
        would take more than `MOST_STEPS`.
        """
        dt, settings = self.settings.time_step, self.settings
        ends = np.isfinite(seconds) & (seconds <= MOST_STEPS * dt)
        longest = np.where(ends, seconds, 0.0) + settings.settling.longest
        simulated = np.minimum(PATIENCE * (1 + settings.guard.tries) * longest, MOST_STEPS * dt)
        return np.where(ends, np.ceil(simulated / LAUNCH_SECONDS), 0).astype(int)

    def begin(self, states: Float[np.ndarray, "worlds u v 3"], motion: Motion) -> None:
        """Initialise the first `len(states)` worlds for a manipulation, with no trace of earlier ones."""
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
        """Advance those of the first `worlds` worlds that are not done by one launch."""
        wp.launch(advance, dim=worlds, inputs=[self.solver, self.state])

    def read(self, name: str, worlds: int) -> np.ndarray:
        """Return a copy of the state's array `name` for the first `worlds` worlds."""
        return getattr(self.state, name).numpy()[:worlds].copy()

    def _write(self, name: str, values: np.ndarray) -> None:
        array = getattr(self.state, name)
        if len(values) < self.count:
            values = np.concatenate([values, array.numpy()[len(values) :]])
        array.assign(values)


def _resampled(path: np.ndarray) -> np.ndarray:
    """Return the paths resampled to PATH points at equal times, by linear interpolation."""
    times = path.shape[2]
    place = np.linspace(0, times - 1, int(PATH))
    low = np.minimum(place.astype(int), times - 2)
    share = (place - low)[:, None]
    return path[:, :, low] * (1 - share) + path[:, :, low + 1] * share
