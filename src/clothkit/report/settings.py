"""Settings of the report."""

from typing import Annotated

from annotated_types import Ge, MinLen

from clothkit.config import config

Count = Annotated[int, Ge(1)]


@config
class ReportConfig:
    """Which systems the tables are about, and how many examples the pictures show."""

    predictors: Annotated[tuple[str, ...], MinLen(1)] = ("main", "a1")
    """Systems of tables 3 and 5."""
    voxel_predictors: Annotated[tuple[str, ...], MinLen(1)] = ("main", "a1", "main_occluded", "a2")
    """Systems of table 4."""
    planners: Annotated[tuple[str, ...], MinLen(1)] = ("main", "b1", "b2", "b3", "b4", "b5", "unrefined")
    """Systems of tables 6 to 8, the first of which is shown in pictures."""
    sequences: Count = 8
    estimates: Count = 6
    predictions: Count = 4
    sessions: Count = 2
    """Of each length."""
    largest: Count = 10
    """Test tasks of the largest planning errors."""
