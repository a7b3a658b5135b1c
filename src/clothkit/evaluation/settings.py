"""Settings of the evaluation stages."""

from typing import Annotated

from annotated_types import Ge, Gt, MinLen

from clothkit.runtime.config import config


@config
class EvaluateEstimationConfig:
    """Settings of the evaluation of estimates."""

    batch: Annotated[int, Gt(0)] = 64
    """Batch size, in meshes. They are refined as `plan.refine` says."""


@config
class EvaluatePredictionConfig:
    """Settings of the evaluation of predictions."""

    batch: Annotated[int, Gt(0)] = 64
    """Batch size, in tasks."""
    stored: Annotated[int, Ge(1)] = 16
    """Number of sequences per split whose three-step predictions are stored for pictures."""


@config
class EvaluatePlanningConfig:
    """Settings of the evaluation of planning."""

    systems: Annotated[tuple[str, ...], MinLen(1)] = ("main", "b1", "b2", "b3", "b4", "b5", "unrefined")
    """Planners whose outcomes are evaluated and compared."""


@config
class ProbeConfig:
    """Settings of the probe stage."""

    sequences: Annotated[int, Gt(0)] = 30
    """Validation sequences whose states are probed."""
    displaced: Annotated[int, Ge(0)] = 1
    """Probes of that kind per state."""
    grasped: Annotated[int, Ge(0)] = 1
    random: Annotated[int, Ge(0)] = 1
    """Random plans per sequence, each from one of its states in turn."""
    edge: float = 0.9
    """Share of later grasp points of random plans on the cloth's edge."""
    seed: Annotated[int, Ge(0)] = 0


@config
class CalibrateConfig:
    """Settings of the calibrate stage."""

    sequences: Annotated[int, Gt(0)] = 10
    """So many of the last validation sequences are planned for, all tasks of each. The first ones are probed."""
