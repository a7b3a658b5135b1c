"""Which planner comes nearer to its goals, how sure that is, and why plans fail: tables 6 and 7, section 6.4."""

from pathlib import Path

import numpy as np
import pandas as pd

from clothkit.dataset.tables import read as read_table
from clothkit.errors import InputError
from clothkit.evaluation.comparisons import COLUMNS, compare, interval, totals
from clothkit.evaluation.occupancy import TALL_MEASURE
from clothkit.evaluation.settings import EvaluatePlanningConfig
from clothkit.evaluation.tidy import PLANNING

ROWS = (
    "split",
    "system",
    "sequence",
    "start",
    "length",
    "error",
    "voxel_error",
    "layers_reversed",
    "nulls_fired",
    "nulls_last",
    "nulls_helped",
    "loss",
    "loss_recorded",
    "expected",
    "grasp_offered",
    "estimate_error",
    "estimate_layers_reversed",
)
"""Columns of tidy rows of planning that are needed here."""

MEASURES = ("error", "voxel_error")
"""By which systems are compared."""

PAIRS = (*(("main", other) for other in ("b1", "b2", "b3", "b4", "b5", "unrefined")), ("b4", "b5"))
"""Systems that the paper holds against one another (section 6.3)."""

LARGE = 0.05
"""An outcome or an estimate that is farther off is called wrong [cloth length]."""

REVERSED = 0.25
"""Where a larger share of layers lies in another order, folds are in another order: it takes one half of those of a
cloth that is folded twice."""


def read(folder: Path, settings: EvaluatePlanningConfig) -> pd.DataFrame:
    """The rows of every system, `<folder>/<system>.parquet` each, one below the other.

    Raises InputError for a file that is not as it should be, or holds rows of another system.
    """
    found = []
    for system in settings.systems:
        path = folder / f"{system}.parquet"
        rows = read_table(path, PLANNING, ROWS)
        others = rows.loc[rows["system"] != system, "system"]
        if len(others):
            raise InputError(f"{path}: column system: expected {system} only, found {others.iloc[0]}")
        found.append(rows)
    return pd.concat(found, ignore_index=True)


def comparisons(tidy: pd.DataFrame) -> pd.DataFrame:
    """`compare` of all PAIRS by all MEASURES; pairs of which the rows hold one system only are left out."""
    present = set(tidy["system"])
    found = [compare(tidy, measure, *pair) for measure in MEASURES for pair in PAIRS if present.issuperset(pair)]
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame(columns=list(COLUMNS))


def intervals(tidy: pd.DataFrame) -> pd.DataFrame:
    """Means over tasks, and their 95 % bootstrap intervals over sequences, by split, system and column of the tables.

    split, system, measure (error [cloth length], voxel_error [mean voxel difference]; voxel_error_025 if the rows
    have it), column (length/start, `all` for every start), sequences, mean, low, high (NaN for fewer
    sequences than `comparisons.LEAST`).
    """
    found = []
    measures = [measure for measure in (*MEASURES, TALL_MEASURE) if measure in tidy]
    for system, rows in tidy.groupby("system", sort=False):
        for measure in measures:
            for part in totals(rows, measure):
                low, high = interval(part.total, part.tasks)
                found.append((part.split, system, measure, part.column, len(part.total), part.mean, low, high))
    return pd.DataFrame(
        found, columns=["split", "system", "measure", "column", "sequences", "mean", "low", "high"]
    ).sort_values(["split", "system", "measure", "column"], ignore_index=True)


def failures(tidy: pd.DataFrame) -> pd.DataFrame:
    """Why outcomes are off, a row per split, system and length (1, 2, 3, all); of every session's first plan.

    tasks; search_failure (share of plans that the nets themselves rate below the recorded manipulations: the search
    missed those); model_failure (share of plans that they rate at least as high, but whose outcome is LARGE off);
    layers_reversed (share of tasks whose outcome has the goal's folds, but more than REVERSED of its layers in another
    order); grasp_offered (share of starts with a candidate at every recorded grasp point); nulls_fired
    (manipulations that the null check cancelled, per session); nulls_helped (of those in a session's last step, the
    share that would have led away from the goal); expected, error (means of what the nets expect and of what came
    [cloth length]); error_estimate_good, error_estimate_bad (mean errors of tasks whose first estimate is within LARGE,
    and beyond). NaN where a system has no such thing.
    """
    missed = tidy["loss_recorded"] < tidy["loss"]
    rated = tidy["loss"].notna() & tidy["loss_recorded"].notna()
    judged = tidy.assign(
        search_failure=missed.astype(float).where(rated),
        model_failure=(~missed & (tidy["error"] > LARGE)).astype(float).where(rated),
        layers_reversed=(tidy["layers_reversed"] > REVERSED).astype(float),
        grasp_offered=tidy["grasp_offered"].astype(float),
        error_estimate_good=tidy["error"].where(tidy["estimate_error"] <= LARGE),
        error_estimate_bad=tidy["error"].where(tidy["estimate_error"] > LARGE),
    )
    counted = pd.concat([judged.assign(length=judged["length"].astype(str)), judged.assign(length="all")])
    groups = counted.groupby(["split", "system", "length"])
    means = (
        "layers_reversed",
        "grasp_offered",
        "nulls_fired",
        "expected",
        "error",
        "error_estimate_good",
        "error_estimate_bad",
    )
    found = groups[["search_failure", "model_failure", *means]].mean()
    last = groups["nulls_last"].sum()
    found.insert(0, "tasks", groups.size())
    helped = groups["nulls_helped"].sum() / last.where(last > 0)
    found.insert(found.columns.tolist().index("nulls_fired") + 1, "nulls_helped", helped)
    return found.reset_index()


def diagnosis(tidy: pd.DataFrame) -> pd.Series:
    """Why a task failed, in the words of section 6.4: the first that is true of its first plan, and of its outcome.

    grasp point not offered (no candidate near a recorded one); estimate wrong (LARGE off); estimate's layers reversed
    (more than REVERSED of them); layers reversed (likewise, the outcome's); search failure (the nets rate the recorded
    manipulations better than what was found); model failure (they expected to come within LARGE of the goal, and did
    not); open.
    """
    causes = {
        "grasp point not offered": ~tidy["grasp_offered"].astype(bool),
        "estimate wrong": tidy["estimate_error"] > LARGE,
        "estimate's layers reversed": tidy["estimate_layers_reversed"] > REVERSED,
        "layers reversed": tidy["layers_reversed"] > REVERSED,
        "search failure": tidy["loss_recorded"] < tidy["loss"],
        "model failure": (tidy["expected"] <= LARGE) & (tidy["error"] > LARGE),
    }
    found = np.select([cause.to_numpy() for cause in causes.values()], list(causes), default="open")
    return pd.Series(found, tidy.index, dtype=object, name="diagnosis")
