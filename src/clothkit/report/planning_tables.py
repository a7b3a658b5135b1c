"""Tables 6 and 7 with intervals, and tables of failures of planning; for the layout see `tables`."""

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

    The statistic LABELLED is the mean error under the dataset's labels of outcome and goal.
    """
    return _outcomes(tidy, intervals, systems, measure="error", number=6, labelled="error_labelled")


def planning_voxels(
    tidy: pd.DataFrame, intervals: pd.DataFrame, systems: Sequence[str], *, measure: str = "voxel_error"
) -> pd.DataFrame:
    """Table 7: the outcomes and goals of table 6, compared as voxels [mean voxel difference].

    `measure` is voxel_error_025 for the viewport that is twice as high.
    """
    return _outcomes(tidy, intervals, systems, measure=measure, number=7)


def planned(tidy: pd.DataFrame) -> pd.DataFrame:
    """The number of sequences that were planned for, by split; columns split, sequences."""
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
        combined = pd.concat([block, own]) if len(own) else block
        blocks.append(_ordered(combined, "statistic", STATISTICS))
    return pd.concat([*blocks, paper.table_of(number, systems)], ignore_index=True)


def _bounds(intervals: pd.DataFrame) -> pd.DataFrame:
    """Intervals as rows with the statistics LOW and HIGH, in the layout of tables 6 and 7."""
    named = intervals.rename(columns={"low": LOW, "high": HIGH})
    long = named.melt(["split", "system", "column"], [LOW, HIGH], var_name="statistic")
    wide = long.pivot(index=["split", "system", "statistic"], columns="column", values="value")
    return wide.reindex(columns=list(TASKS)).reset_index().rename_axis(columns=None).assign(source="clothkit")


def comparisons(tidy: pd.DataFrame, systems: Sequence[str]) -> pd.DataFrame:
    """Paired comparisons among the given systems, ordered by system and by the columns of table 6."""
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
    """The test tasks of a system with the largest errors, the largest first, with a diagnosis of the failure.

    Columns: LARGEST, diagnosis. Errors and `expected` are in cloth lengths. All columns of LARGEST refer to the first
    plan, except the task's, `error` and `layers_reversed`, which refer to the outcome.
    """
    own = tidy[(tidy["system"] == system) & (tidy["split"] == "test")]
    own = own.assign(diagnosis=diagnosis(own))
    order = ["error", "sequence", "start", "length"]
    chosen = own.sort_values(order, ascending=[False, True, True, True], ignore_index=True)[:count]
    return chosen[[*LARGEST, "diagnosis"]]
