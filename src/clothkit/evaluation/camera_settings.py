"""Settings of the evaluation of what depth cameras see."""

from typing import Annotated

from annotated_types import Ge, Gt, Lt, MinLen

from clothkit.config import config
from clothkit.observation.picture import PictureConfig

UNMEASURED = -1.0
"""In stored pictures [m], of what was not measured."""


@config
class Condition:
    """How a camera looks, and how well."""

    name: Annotated[str, MinLen(1)]
    tilt: Annotated[float, Ge(0), Lt(1.5)] = 0.0
    """Of the view from straight down [rad]."""
    noise: Annotated[float, Ge(0)] = 0.0
    """Multiple of `picture.noise`."""


@config
class EvaluateCameraConfig:
    """What is looked at, and under which conditions."""

    conditions: Annotated[tuple[Condition, ...], MinLen(1)] = (
        Condition(name="above"),
        Condition(name="tilted", tilt=0.35),
        Condition(name="noise x1", tilt=0.35, noise=1.0),
        Condition(name="noise x2", tilt=0.35, noise=2.0),
        Condition(name="noise x4", tilt=0.35, noise=4.0),
    )
    picture: PictureConfig = PictureConfig()
    estimated: Annotated[int, Gt(0)] = 100
    """Test sequences whose states are looked at."""
    planned: Annotated[int, Gt(0)] = 10
    """Of these, how many are planned for, all six tasks of each; no more than plan.test."""
    stored: Annotated[int, Gt(0)] = 2
    """Of these, how many have their pictures kept."""
