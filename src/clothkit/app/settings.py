"""Settings of the command line that describe your cloth, camera and robot."""

from typing import Annotated

from annotated_types import Ge, Gt, MaxLen

from clothkit.estimation.agreement import AgreementConfig
from clothkit.observation.settings import CloudConfig, Triple
from clothkit.observation.waypoints import MotionConfig, ReachConfig
from clothkit.planning.lengths import LengthConfig
from clothkit.runtime.config import config
from clothkit.simulation.settings import SimulationConfig


@config
class BallConfig:
    """The ball that a robot's hand can reach [m], in the table's frame."""

    centre: Triple
    radius: Annotated[float, Gt(0)]


@config
class AppConfig:
    """Settings of the command line, the same at every scale; a command's options override them."""

    side: Annotated[float, Gt(0)] = SimulationConfig().cloth_side
    """Side of the flat cloth, the longer one if it is no square [m]."""
    shorter: Annotated[float, Gt(0)] | None = None
    """Its shorter side [m]; None: it is a square."""
    thickness: Annotated[float, Gt(0)] = SimulationConfig().material.thickness
    """Distance of the middles of two layers that touch, such as half the height of a cloth folded once [m]."""
    table: tuple[float, float, float, float] | None = None
    """a, b, c, d of the table's plane a x + b y + c z = d [m] in the clouds' frame, (a, b, c) up; None: fitted."""
    up: Triple | None = None
    """Up direction in the clouds' frame, of any length; None: inferred from the table, the viewpoint or the cloth."""
    viewpoint: Triple | None = None
    """Camera position in the clouds' frame [m]; None: that in a cloud's file, else the origin, if the cloth agrees."""
    y_up: bool = False
    """Whether y, and not z, is up in OBJ and PLY meshes, and in clouds if table, up and viewpoint are not given."""
    cloud: CloudConfig = CloudConfig()
    """`surface` 0 stands for half the thickness that is told; `highest` is at least the top of the nets' viewport."""
    agreement: AgreementConfig | None = None
    """Thresholds of agreement from which an estimate counts as explaining its observation; None: the nets' own."""
    motion: MotionConfig = MotionConfig()
    reach: ReachConfig | None = None
    """The box that both hands reach; None: no limit, but for `hands`."""
    hands: Annotated[tuple[ReachConfig | BallConfig, ...], MaxLen(2)] = ()
    """What hands reach, if `reach` does not say it: one box or ball for both, or one for each."""
    keep_out: tuple[ReachConfig | BallConfig, ...] = ()
    """Boxes and balls that no hand may enter."""
    apart: Annotated[float, Ge(0)] = 0.0
    """Least distance between the two hands of a manipulation [m]."""
    length: LengthConfig = LengthConfig()
    """How `clothkit plan --steps auto` chooses the number of manipulations."""

    def __post_init__(self) -> None:
        if self.reach is not None and self.hands:
            raise ValueError("reach and hands both say what the hands reach, expected one of them")
