"""Settings of the simulation: solver and limits of acceptance, in SI units unless said otherwise."""

from typing import Annotated, Literal

from annotated_types import Ge, Gt
from pydantic import BeforeValidator

from clothkit.config import config
from clothkit.manipulation.candidates import CandidateConfig
from clothkit.manipulation.sampling import SamplingConfig
from clothkit.simulation.material import Material, NotNegative, Positive, of_fabric


@config
class Settling:
    """From release to rest."""

    interval: Positive = 0.01  # s, speeds are means over so long: what trembles within it is at rest
    rest_speed: Positive = 0.01  # m/s, of the fastest vertex
    rest_time: Positive = 0.25  # s, for so long
    longest: Positive = 4.0  # s


@config
class Guard:
    """Against tangles: a world in which edges begin to pierce triangles goes back, and takes care."""

    interval: Positive = 0.1  # s, between two searches
    care: Positive = 0.05  # s, of care after the time of what was undone
    tries: Annotated[int, Gt(0)] = 3  # at a crossing, from the second on without speed, before it is let be
    passes: Annotated[int, Gt(1)] = 3  # over the contacts, instead of one, while care is taken


@config
class SimulationConfig:
    """The simulated world."""

    side: Annotated[int, Ge(4)] = 32  # vertices along a side of the grid
    cloth_side: Positive = 0.4  # m
    time_step: Positive = 1e-3  # s
    hand_speed: Positive = 0.42  # m/s, mean along the arc
    shortest_move: Positive = 0.4  # s
    highest_lift: Positive = 0.2  # normalised, section 4.2.2: hands end at min(highest_lift, k / 2)
    grasp: Literal["top", "all"] = "top"  # layers that a hand takes
    top_speed: Positive = 0.7  # m/s, so that no vertex moves further than layers are apart in a time step
    push_speed: Positive = 0.3  # m/s, at which penetrations are removed
    material: Annotated[Material, BeforeValidator(of_fabric)] = Material()  # or the name of one of the FABRICS
    settling: Settling = Settling()
    guard: Guard = Guard()
    device: Literal["cpu", "cuda"] = "cpu"

    @property
    def spacing(self) -> float:
        """Metres between neighbouring vertices."""
        return self.cloth_side / (self.side - 1)


@config
class Limits:
    """What a state must keep to be accepted."""

    height: Positive = 0.125  # normalised, of the highest vertex: the viewport's
    residual_speed: Positive = 0.01  # m/s
    strain_p99: Positive = 0.03  # 99th percentile of |length / rest - 1| over the grid's edges
    strain_worst: Positive = 0.1
    intersections: Annotated[int, Ge(0)] = 0
    gap: NotNegative = 0.5  # of the thickness, least distance of a vertex to the surface outside its two-ring
    below_table: NotNegative = 0.0  # m, how far a vertex may lie below the table


@config
class SimulateConfig:
    """The stage that records sequences.

    With source arcsim it takes the first `sequences` of the table runs.csv, all of them if there are fewer, and what
    follows `runs` matters only to the worlds in which plans are executed.
    """

    sequences: Annotated[int, Gt(0)]  # accepted ones to be recorded
    source: Literal["own", "arcsim"] = "own"  # our solver, or runs of ARCSim that are there already
    runs: str = ""  # with source arcsim: the folder that holds runs.csv, from the repository's root
    seed: Annotated[int, Ge(0)] = 0
    block: Annotated[int, Gt(0)] = 4  # attempts that a worker takes at a time; changes no outcome
    workers: Annotated[int, Ge(0)] = 0  # processes, 0 for one per core; changes no outcome
    simulation: SimulationConfig = SimulationConfig()
    limits: Limits = Limits()
    sampling: SamplingConfig = SamplingConfig()
    candidates: CandidateConfig = CandidateConfig()
