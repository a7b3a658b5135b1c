"""Settings of the report."""

from typing import Annotated

from annotated_types import Ge, MinLen

from clothkit.runtime.config import config

Count = Annotated[int, Ge(1)]


@config
class ReportConfig:
    """The systems in the tables, and the numbers of examples in the pictures."""

    predictors: Annotated[tuple[str, ...], MinLen(1)] = ("main", "a1")
    """Systems of tables 3 and 5."""
    voxel_predictors: Annotated[tuple[str, ...], MinLen(1)] = ("main", "a1", "main_occluded", "a2")
    """Systems of table 4."""
    planners: Annotated[tuple[str, ...], MinLen(1)] = ("main", "b1", "b2", "b3", "b4", "b5", "unrefined")
    """Systems of tables 6 to 8; pictures show the first one."""
    sequences: Count = 8
    estimates: Count = 6
    predictions: Count = 4
    sessions: Count = 2
    """Number of sessions of each length."""
    goals: bool = False
    """Whether plans for named goals were evaluated (`evaluate_goals`)."""
    paper: bool = True
    """Whether tables have the paper's rows, and tables 4 and 7 are there, whose voxels are those of its viewport.

    False where the cloths are not the paper's."""
    largest: Count = 10
    """Number of test tasks with the largest planning errors."""
