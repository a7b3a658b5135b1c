"""Tables 6 and 7 with their intervals, and what goes wrong in planning: the other tables' layout, see `tables`."""

from collections.abc import Sequence

import pandas as pd

from clothkit.evaluation.planning import diagnosis
from clothkit.report import layout, paper, rows, tables
from clothkit.report.layout import HIGH, LABELLED, LOW, RATIO, TASKS

STATISTICS = (*layout.STATISTICS, LOW, HIGH, LABELLED, RATIO)

LARGEST = (
    "sequence",
    "start",
    "length",
    "error",
    "layers_reversed",
    "estimate_error",
    "estimate_layers_reversed",
    "expected",
    "loss",
    "loss_recorded",
    "grasp_offered",
)
"""Columns of the table of the largest errors, before the diagnosis."""


def planning(tidy: pd.DataFrame, intervals: pd.DataFrame, systems: Sequence[str]) -> pd.DataFrame:
    """Table 6 [cloth length]. Outcomes are aligned with their goals (section 6.3).

    The statistic LABELLED: outcome and goal as the dataset labels them.
    """
    return _outcomes(tidy, intervals, systems, measure="error", number=6, labelled="error_labelled")


def planning_voxels(
    tidy: pd.DataFrame, intervals: pd.DataFrame, systems: Sequence[str], *, measure: str = "voxel_error"
) -> pd.DataFrame:
    """Table 7: the same outcomes and goals in voxels [mean voxel difference].

    `measure`: voxel_error_025 for the viewport that is twice as high.
    """
    return _outcomes(tidy, intervals, systems, measure=measure, number=7)


def planned(tidy: pd.DataFrame) -> pd.DataFrame:
    """How many sequences were planned for, by split: split, sequences."""
    splits = [split for split in ("test", "train") if split in set(tidy["split"])]
    counts = [tidy.loc[tidy["split"] == split, "sequence"].nunique() for split in splits]
    return pd.DataFrame({"split": splits, "sequences": counts})


def _outcomes(
    tidy: pd.DataFrame,
    intervals: pd.DataFrame,
    systems: Sequence[str],
    *,
    measure: str,
    number: int,
    labelled: str | None = None,
) -> pd.DataFrame:
    rows.require(tidy, systems)
    table = tables.task_table(tidy, systems, measure=measure)
    more = [_bounds(intervals[intervals["measure"] == measure])]
    if labelled:
        found = tables.task_table(tidy.assign(**{measure: tidy[labelled]}), systems, measure=measure)
        more.append(found[found["statistic"] == "mean"].assign(statistic=LABELLED))
    bounds = pd.concat(more)
    bounds = bounds[bounds["system"].isin(list(systems))]
    blocks = []
    for (split, system), block in table.groupby(["split", "system"], sort=False):
        own = bounds[(bounds["split"] == split) & (bounds["system"] == system)]
        whole = pd.concat([block, own]) if len(own) else block
        blocks.append(_ordered(whole, "statistic", STATISTICS))
    return pd.concat([*blocks, paper.table_of(number, systems)], ignore_index=True)


def _bounds(intervals: pd.DataFrame) -> pd.DataFrame:
    """Intervals as rows of a table."""
    named = intervals.rename(columns={"low": LOW, "high": HIGH})
    long = named.melt(["split", "system", "column"], [LOW, HIGH], var_name="statistic")
    wide = long.pivot(index=["split", "system", "statistic"], columns="column", values="value")
    return wide.reindex(columns=list(TASKS)).reset_index().rename_axis(columns=None).assign(source="clothkit")


def comparisons(tidy: pd.DataFrame, systems: Sequence[str]) -> pd.DataFrame:
    """Paired comparisons among the given systems, in their order and that of the other tables' columns."""
    chosen = tidy[tidy["system"].isin(list(systems)) & tidy["against"].isin(list(systems))]
    for name, order in (("column", TASKS), ("against", systems), ("system", systems)):
        chosen = _ordered(chosen, name, order)
    return chosen.sort_values(["split", "measure"], kind="stable", ignore_index=True)


def failures(tidy: pd.DataFrame, systems: Sequence[str]) -> pd.DataFrame:
    """Rows of `evaluation.planning.failures` of the given systems, in their order."""
    chosen = _ordered(tidy[tidy["system"].isin(list(systems))], "system", systems)
    return chosen.sort_values("split", kind="stable", ignore_index=True)


def _ordered(table: pd.DataFrame, column: str, order: Sequence[str]) -> pd.DataFrame:
    return table.sort_values(column, key=lambda values: values.map(order.index), kind="stable")


def largest(tidy: pd.DataFrame, system: str, count: int) -> pd.DataFrame:
    """The test tasks of a system with the largest errors, the largest first, and why they failed.

    LARGEST (errors and expected [cloth length]; all but error and layers_reversed of the first plan), diagnosis.
    """
    own = tidy[(tidy["system"] == system) & (tidy["split"] == "test")]
    own = own.assign(diagnosis=diagnosis(own))
    order = ["error", "sequence", "start", "length"]
    chosen = own.sort_values(order, ascending=[False, True, True, True], ignore_index=True)[:count]
    return chosen[[*LARGEST, "diagnosis"]]
