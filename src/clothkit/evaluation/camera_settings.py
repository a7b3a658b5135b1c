"""Settings of the evaluations with depth cameras."""

from typing import Annotated

from annotated_types import Ge, Gt, Lt, MinLen

from clothkit.observation.picture import PictureConfig
from clothkit.runtime.config import config

UNMEASURED = -1.0
"""Height in stored pictures [m] of pixels without a measurement."""


@config
class Condition:
    """A camera's tilt and noise level."""

    name: Annotated[str, MinLen(1)]
    tilt: Annotated[float, Ge(0), Lt(1.5)] = 0.0
    """Angle between the view and straight down [rad]."""
    noise: Annotated[float, Ge(0)] = 0.0
    """Factor applied to `picture.noise`."""


@config
class EvaluateCameraConfig:
    """The evaluated sequences and the camera conditions."""

    conditions: Annotated[tuple[Condition, ...], MinLen(1)] = (
        Condition(name="above"),
        Condition(name="tilted", tilt=0.35),
        Condition(name="noise x1", tilt=0.35, noise=1.0),
        Condition(name="noise x2", tilt=0.35, noise=2.0),
        Condition(name="noise x4", tilt=0.35, noise=4.0),
    )
    picture: PictureConfig = PictureConfig()
    estimated: Annotated[int, Gt(0)] = 100
    """Number of test sequences whose states are estimated."""
    planned: Annotated[int, Gt(0)] = 10
    """Number of the first of these that are planned for, with all six tasks of each; at most plan.test."""
    stored: Annotated[int, Gt(0)] = 2
    """Number of the first sequences of which a state's pictures are stored."""


@config
class SetAlarmsConfig:
    """Settings of the thresholds from which an observation counts as unknown, or its estimate as wrong."""

    share: Annotated[float, Ge(0), Lt(1)] = 0.02
    """Share of the validation states that may raise an alarm, as exact voxels and before a depth camera.

    Of other states, more do: the fewer sequences the split has, the more.
    """
    sequences: Annotated[int, Gt(0)] = 100
    """Largest number of validation sequences whose states are observed and estimated."""
    examples: Annotated[int, Gt(0)] = 8192
    """Number of training examples that the net's support is made of."""
    conditions: tuple[Condition, ...] = (Condition(name="noise x1", tilt=0.35, noise=1.0),)
    """The cameras, whose noise is that of `evaluate_camera.picture`."""
    seed: Annotated[int, Ge(0)] = 0
