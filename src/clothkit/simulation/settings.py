"""Settings of the simulation: solver and limits of acceptance, in SI units unless said otherwise."""

from dataclasses import fields, replace
from typing import Annotated, Any, Literal

import pydantic
from annotated_types import Ge, Gt, Le
from pydantic import BeforeValidator

from clothkit.cloth.topology import CLOTH_LENGTH, Topology, square
from clothkit.manipulation.candidates import CandidateConfig
from clothkit.manipulation.sampling import SamplingConfig
from clothkit.runtime.config import config
from clothkit.simulation.material import Material, NotNegative, Positive, of_fabric

LEAST_VERTICES, MOST_VERTICES = 8, 64
"""Least and largest number of vertices along a side of a cloth."""

LEAST_SPACING = 1.5
"""Least distance of neighbouring vertices, in thicknesses: on a finer grid the contacts prevent folding."""


@config
class Settling:
    """Settling, from release to rest. The ranges are those in which sequences of folds were tried."""

    interval: Annotated[float, Ge(2e-3), Le(0.1)] = 0.01  # s, over which speeds are averaged, to ignore trembling
    rest_speed: Annotated[float, Ge(1e-3), Le(0.1)] = 0.01  # m/s, limit for the fastest vertex
    rest_time: Annotated[float, Ge(0.01), Le(60)] = 0.25  # s, for which the speeds must be below it
    longest: Annotated[float, Ge(0.1), Le(60)] = 4.0  # s, after which an attempt is given up


@config
class Guard:
    """The guard against tangles: if new edges pierce triangles, the world is reset and simulated in careful mode.

    The ranges are those in which sequences of folds were tried.
    """

    interval: Annotated[float, Ge(0.02), Le(1)] = 0.1  # s, between two searches
    care: Annotated[float, Ge(0.01), Le(0.5)] = 0.05  # s, duration of the careful mode after the undone crossing
    tries: Annotated[int, Ge(1), Le(10)] = 3  # attempts to avoid a crossing, from the second on from zero velocity
    passes: Annotated[int, Ge(2), Le(10)] = 3  # over the contacts in careful mode, in place of one


@config
class SimulationConfig:
    """The simulated world.

    The ranges are those in which sequences of folds were tried: within them an attempt ends in seconds to minutes, and
    most folds are accepted or rejected for a reason; outside them an attempt may take hours or fail.

    Two checks combine settings: neighbouring vertices must be at least one and a half thicknesses of the material
    apart, and the hands must not be faster than `top_speed`.
    """

    side: Annotated[int, Ge(LEAST_VERTICES), Le(MOST_VERTICES)] = 32  # vertices along a side of the square grid
    cloth_side: Annotated[float, Ge(0.1), Le(1)] = 0.4  # m, the longer side of a cloth that is no square
    time_step: Annotated[float, Ge(2e-4), Le(2e-3)] = 1e-3  # s
    hand_speed: Annotated[float, Ge(0.05), Le(0.7)] = 0.42  # m/s, mean along the arc
    shortest_move: Annotated[float, Ge(0.05), Le(10)] = 0.4  # s, least duration of a hand's motion
    # normalised, section 4.2.2: hands end at min(highest_lift, k / 2)
    highest_lift: Annotated[float, Ge(0.02), Le(0.7)] = 0.2
    grasp: Literal["top", "all"] = "top"  # layers that a hand grasps
    # m/s, so that no vertex moves further than the distance of layers in a time step
    top_speed: Annotated[float, Ge(0.1), Le(5)] = 0.7
    push_speed: Annotated[float, Ge(0.03), Le(3)] = 0.3  # m/s, at which penetrations are removed
    material: Annotated[Material, BeforeValidator(of_fabric)] = Material()  # or the name of one of the FABRICS
    settling: Settling = Settling()
    guard: Guard = Guard()

    @property
    def topology(self) -> Topology:
        """The square cloth with `side` vertices along each side: what is simulated where no other is given."""
        return square(self.side)

    def sides(self, topology: Topology) -> tuple[float, float]:
        """The flat cloth's sides along u and along v, in metres."""
        along_u, along_v = (self.cloth_side * (length / CLOTH_LENGTH) for length in topology.sides)
        return along_u, along_v

    def spacing(self, topology: Topology) -> tuple[float, float]:
        """Metres between neighbouring vertices of a cloth along u and along v."""
        (along_u, along_v), (rows, columns) = self.sides(topology), topology.shape
        return along_u / (rows - 1), along_v / (columns - 1)

    @pydantic.model_validator(mode="after")
    def _agrees(self) -> "SimulationConfig":
        self.check(self.topology)
        if self.hand_speed > self.top_speed:
            raise ValueError(
                f"hand_speed is {self.hand_speed:g} m/s, expected at most top_speed, {self.top_speed:g} m/s: no vertex "
                "follows a faster hand"
            )
        return self

    def check(self, topology: Topology) -> None:
        """Raise ValueError if the solver can't simulate a cloth of this topology with these settings."""
        if not LEAST_VERTICES <= min(topology.shape) <= max(topology.shape) <= MOST_VERTICES:
            raise ValueError(
                f"a grid of {topology.shape[0]} x {topology.shape[1]} vertices, expected {LEAST_VERTICES} to "
                f"{MOST_VERTICES} along each side"
            )
        spacing, least = min(self.spacing(topology)), LEAST_SPACING * self.material.thickness
        if spacing < least:
            raise ValueError(
                f"cloth_side / (side - 1), the distance of neighbouring vertices, is {spacing:.2g} m, expected at "
                f"least {least:.2g} m, {LEAST_SPACING:g} times material.thickness"
            )


@config
class Limits:
    """Limits that a state must keep to be accepted."""

    height: Positive = 0.125  # normalised, of the highest vertex; the default is the viewport's height
    residual_speed: Positive = 0.01  # m/s
    strain_p99: Positive = 0.03
    """99th percentile of the strain of the grid's edges: length / rest - 1; of shortened ones, only what they lack of
    the chord of the fold over which they are bent (`Quality.strain_p99`)."""
    strain_worst: Positive = 0.1
    intersections: Annotated[int, Ge(0)] = 0
    gap: NotNegative = 0.5  # thicknesses, least distance of a vertex to the surface outside its two-ring
    below_table: NotNegative = 0.0  # m, how far a vertex may lie below the table


Start = Literal["flat", "dragged", "dropped"]
STARTS: tuple[Start, ...] = ("flat", "dragged", "dropped")
Range = tuple[Positive, Positive]
"""Lowest and highest value."""

DRAWN = (
    *("thickness", "density", "stretch_stiffness", "shear_stiffness", "bending_stiffness", "bending_limit"),
    *("cloth_friction", "table_friction"),
)
"""Properties of the material that a sequence can draw."""


def _check_order(settings: object, names: tuple[str, ...]) -> None:
    for name in names:
        limits = getattr(settings, name)
        if limits and limits[0] > limits[1]:
            raise ValueError(f"{name} is from {limits[0]:g} to {limits[1]:g}, expected the lower value first")


@config
class Starts:
    """How sequences begin: with a cloth that lies flat, that was dragged over the table, or dropped on it."""

    flat: NotNegative = 1.0  # shares of the sequences
    dragged: NotNegative = 0.0
    dropped: NotNegative = 0.0
    drag: Range = (0.1, 0.5)  # distance, in longer sides of the cloth
    # height from which the hand lets go, in longer sides: above 1.4 all of a square hangs free
    drop: Range = (0.4, 1.2)

    @pydantic.model_validator(mode="after")
    def _agrees(self) -> "Starts":
        _check_order(self, ("drag", "drop"))
        if not self.flat + self.dragged + self.dropped > 0:
            raise ValueError("flat, dragged and dropped are all 0, expected at least one share above 0")
        return self


@config
class VariationConfig:
    """What each sequence draws, log-uniformly from ranges; without a range, the value is that of `simulation`."""

    thickness: Range | None = None  # m; at most what the grid's spacing allows
    density: Range | None = None  # kg/m^2
    stretch_stiffness: Range | None = None  # N/m
    shear_stiffness: Range | None = None  # N/m
    bending_stiffness: Range | None = None  # N m
    bending_limit: Range | None = None  # 1/m
    cloth_friction: Range | None = None
    table_friction: Range | None = None
    squares: Annotated[float, Ge(0), Le(1)] = 1.0  # share of the sequences; the others' cloths are rectangles
    ratio: Range = (1.0, 1.8)  # of a rectangle's longer side to its shorter one
    starts: Starts = Starts()
    # share of the sequences with a flat start whose first manipulations are, nearly, the folds of a named goal; the
    # others' are random, as all that follow
    named: Annotated[float, Ge(0), Le(1)] = 0.0

    @pydantic.model_validator(mode="after")
    def _agrees(self) -> "VariationConfig":
        _check_order(self, (*DRAWN, "ratio"))
        if self.ratio[0] < 1:
            raise ValueError(
                f"ratio is from {self.ratio[0]:g}, expected at least 1: the longer side to the shorter one"
            )
        for name in DRAWN:
            for value in getattr(self, name) or ():
                replace(Material(), **{name: value})  # which checks its range
        return self


INDIFFERENT = ("block", "workers", "executor", "scheduler")
"""Settings of the stage `simulate` that say who makes what at a time, and change no outcome."""


@config
class SimulateConfig:
    """Settings of the stage that records sequences.

    With source arcsim, the stage imports the first `sequences` sequences of the table runs.csv, or all if there are
    fewer; the settings after `runs` then only affect the worlds in which plans are executed.
    """

    sequences: Annotated[int, Gt(0), Le(10**6)]  # accepted ones to be recorded
    source: Literal["own", "arcsim"] = "own"  # our solver, or existing ARCSim runs
    runs: str = ""  # with source arcsim: the folder that holds runs.csv, from the repository's root
    seed: Annotated[int, Ge(0)] = 0
    # The next four are those of INDIFFERENT.
    block: Annotated[int, Gt(0), Le(4096)] = 4  # attempts per job of a worker
    workers: Annotated[int, Ge(0), Le(1024)] = 0  # processes, 0 for one per core
    executor: Literal["processes", "dask"] = "processes"  # who simulates, in every stage that does
    # with executor dask: the scheduler's address, or its file; empty: DASK_SCHEDULER_ADDRESS, or a cluster of this
    # machine's own, of `workers` processes
    scheduler: str = ""
    simulation: SimulationConfig = SimulationConfig()
    variation: VariationConfig | None = None  # of cloths and starts between sequences; without it, all are alike
    limits: Limits = Limits()
    sampling: SamplingConfig = SamplingConfig()
    candidates: CandidateConfig = CandidateConfig()

    @pydantic.model_validator(mode="after")
    def _agrees(self) -> "SimulateConfig":
        if self.scheduler and self.executor != "dask":
            raise ValueError(f"scheduler is {self.scheduler}, expected executor: dask with it, found {self.executor}")
        return self

    @property
    def decisive(self) -> "SimulateConfig":
        """The same with INDIFFERENT settings at their defaults; runs with equal ones have equal outcomes."""
        defaults: dict[str, Any] = {each.name: each.default for each in fields(self) if each.name in INDIFFERENT}
        return replace(self, **defaults)
