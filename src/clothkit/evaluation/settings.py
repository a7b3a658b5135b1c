"""Settings of the evaluation stages."""

from typing import Annotated

from annotated_types import Ge, Gt

from clothkit.config import config
from clothkit.estimation.refine import RefineConfig


@config
class EvaluateEstimationConfig:
    """Settings of the evaluation of estimates."""

    refine: RefineConfig = RefineConfig()
    batch: Annotated[int, Gt(0)] = 64
    """Meshes estimated at a time."""


@config
class EvaluatePredictionConfig:
    """Settings of the evaluation of predictions."""

    batch: Annotated[int, Gt(0)] = 64
    """Tasks predicted at a time."""
    stored: Annotated[int, Ge(1)] = 16
    """Sequences of each split whose three-step predictions are kept for pictures."""
