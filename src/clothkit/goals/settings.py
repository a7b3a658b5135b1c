"""Settings of the evaluation of named goals."""

from typing import Annotated, Literal

import pydantic
from annotated_types import Ge, Gt, MinLen

from clothkit.evaluation.camera_settings import Condition
from clothkit.manipulation.named_folds import GOALS
from clothkit.runtime.config import config

StartName = Literal["flat", "dragged", "crumpled"]
SourceName = Literal["mesh", "camera", "script"]

START_NAMES: tuple[StartName, ...] = ("flat", "dragged", "crumpled")
SOURCE_NAMES: tuple[SourceName, ...] = ("mesh", "camera", "script")
"""Where the state comes from that is planned from; script: nothing is planned, the goal's own folds are executed."""

SYSTEM_OF = {"mesh": "b1", "camera": "main"}
"""The system that plans from each source."""


@config
class EvaluateGoalsConfig:
    """Which named goals are planned for, from where, and how often."""

    goals: Annotated[tuple[str, ...], MinLen(1)] = tuple(GOALS)
    starts: Annotated[tuple[StartName, ...], MinLen(1)] = START_NAMES
    """How the cloth lies at first: flat, dragged over the table, or dropped on it (`simulate.variation.starts`)."""
    sources: Annotated[tuple[SourceName, ...], MinLen(1)] = SOURCE_NAMES
    repeats: Annotated[int, Gt(0)] = 2
    """How often each goal is planned for from each start: each time the cloth lies at another angle, and is another one
    where `simulate.variation` says so."""
    condition: Condition = Condition(name="noise x1", tilt=0.35, noise=1.0)
    """The depth camera, with the noise of `evaluate_camera.picture`."""
    seed: Annotated[int, Ge(0)] = 1000
    """Of cloths and starts; none of the dataset's if it is another than `simulate.seed`."""

    @pydantic.model_validator(mode="after")
    def _agrees(self) -> "EvaluateGoalsConfig":
        if unknown := [name for name in self.goals if name not in GOALS]:
            raise ValueError(f"goals has {unknown[0]!r}, expected some of {', '.join(GOALS)}")
        for name in ("goals", "starts", "sources"):
            if len(set(getattr(self, name))) < len(getattr(self, name)):
                raise ValueError(f"{name} has something twice, expected each once")
        return self
