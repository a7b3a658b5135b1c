"""What commands assume of your cloth, your camera and your robot."""

from typing import Annotated

from annotated_types import Gt

from clothkit.config import config
from clothkit.observation.settings import CloudConfig
from clothkit.observation.waypoints import MotionConfig, ReachConfig
from clothkit.simulation.settings import SimulationConfig


@config
class AppConfig:
    """Settings of the command line, for every scale; options of a command win over them."""

    side: Annotated[float, Gt(0)] = SimulationConfig().cloth_side
    """Of the flat cloth [m]."""
    table: tuple[float, float, float, float] | None = None
    """a, b, c, d of the table's plane a x + b y + c z = d [m] in the clouds' frame, (a, b, c) up; None: it is found."""
    cloud: CloudConfig = CloudConfig()
    motion: MotionConfig = MotionConfig()
    reach: ReachConfig | None = None
    """The box that the hands reach; None: they reach everything."""
