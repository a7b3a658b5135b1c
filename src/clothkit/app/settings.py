"""What commands assume of your cloth, your camera and your robot."""

from typing import Annotated

from annotated_types import Gt

from clothkit.config import config
from clothkit.estimation.agreement import AgreementConfig
from clothkit.observation.settings import CloudConfig, Triple
from clothkit.observation.waypoints import MotionConfig, ReachConfig
from clothkit.simulation.settings import SimulationConfig


@config
class AppConfig:
    """Settings of the command line, for every scale; options of a command win over them."""

    side: Annotated[float, Gt(0)] = SimulationConfig().cloth_side
    """Of the flat cloth [m]."""
    table: tuple[float, float, float, float] | None = None
    """a, b, c, d of the table's plane a x + b y + c z = d [m] in the clouds' frame, (a, b, c) up; None: it is found."""
    up: Triple | None = None
    """Which way is up in the clouds' frame, of any length; None: told by the table, the viewpoint, or the cloth."""
    viewpoint: Triple | None = None
    """Where the camera is in the clouds' frame [m]; None: where a cloud says, else the origin, if its cloth agrees."""
    y_up: bool = False
    """Whether OBJ and PLY meshes, and clouds of which nothing else is told, have y up, and not z."""
    cloud: CloudConfig = CloudConfig()
    agreement: AgreementConfig = AgreementConfig()
    """From which agreement on an estimate is said to explain what was seen."""
    motion: MotionConfig = MotionConfig()
    reach: ReachConfig | None = None
    """The box that the hands reach; None: they reach everything."""
