"""Settings of the simulation: material, solver and limits of acceptance, in SI units unless said otherwise."""

from typing import Annotated, Literal

from annotated_types import Ge, Gt

from clothkit.config import config
from clothkit.manipulation.candidates import CandidateConfig
from clothkit.manipulation.sampling import SamplingConfig

Positive = Annotated[float, Gt(0.0)]
NotNegative = Annotated[float, Ge(0.0)]


@config
class Material:
    """The cloth and the table."""

    thickness: Positive = 2e-3  # m, distance of touching layers
    edge_thickness: Positive = 1.5e-3  # m, distance of touching edges
    bending_length: Positive = 0.022  # m, cube root of bending stiffness over weight
    bending_saturation: Positive = 0.4  # grid spacings of second difference, where the moment stops growing
    crease_length: Positive = 0.4  # grid spacings, vertices two apart come no closer
    crease_stiffness: Positive = 4.0  # times that of bending
    shear_compliance: NotNegative = 50.0  # per unit mass over dt squared
    diagonal_shortest: Positive = 0.35  # of its rest length: the free diagonal's range
    diagonal_longest: Positive = 1.02
    cloth_friction: NotNegative = 0.5
    table_friction: NotNegative = 0.7
    viscosity: NotNegative = 0.3  # share of the neighbours' velocity difference taken over in a substep


@config
class Settling:
    """From release to rest. Air drag grows, and the top speed falls, until the cloth is calm."""

    gravity: Positive = 1.5  # factor on gravity
    press_height: Positive = 0.02  # m, what stands above is pulled down harder
    press_gain: NotNegative = 300.0  # 1/m, added to the factor per height
    press_limit: NotNegative = 9.0  # largest addition
    drag: NotNegative = 4.0  # 1/s
    drag_growth: NotNegative = 4.0  # 1/s
    contact_damping: NotNegative = 50.0  # 1/s
    calm_after: NotNegative = 0.6  # s, from then on the top speed decays
    speed_decay: NotNegative = 5.0  # 1/s
    last_speed: Positive = 0.008  # m/s, the top speed decays to this
    rest_speed: Positive = 0.01  # m/s, mean over a check's interval
    check_interval: Positive = 0.05  # s
    checks: Annotated[int, Gt(0)] = 2  # passed in a row
    longest: Positive = 2.0  # s
    rounds: Annotated[int, Gt(0)] = 3  # of untangling, each but the last followed by settling


@config
class SimulationConfig:
    """The simulated world."""

    side: Annotated[int, Ge(4)] = 32  # vertices along a side of the grid
    cloth_side: Positive = 0.4  # m
    time_step: Positive = 1e-3  # s
    hand_speed: Positive = 0.42  # m/s, mean along the arc
    shortest_move: Positive = 0.4  # s
    highest_lift: Positive = 0.2  # normalised, section 4.2.2: hands end at min(highest_lift, k / 2)
    drag: NotNegative = 2.0  # 1/s, while hands move
    top_speed: Positive = 2.0  # m/s
    largest_step: Positive = 0.7e-3  # m, no vertex moves further in a substep: nothing tunnels
    push_speed: Positive = 0.3  # m/s, at which penetrations are removed
    material: Material = Material()
    settling: Settling = Settling()
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
    strain_p99: Positive = 0.06  # 99th percentile of |length / rest - 1| over the grid's edges
    strain_worst: Positive = 0.3
    intersections: Annotated[int, Ge(0)] = 0
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
