"""Evaluation of planning: comparisons of systems, intervals and causes of failure (tables 6 and 7, section 6.4)."""

from pathlib import Path

import numpy as np
import pandas as pd

from clothkit.dataset.tables import read as read_table
from clothkit.evaluation.comparisons import COLUMNS, compare, interval, totals
from clothkit.evaluation.occupancy import TALL_MEASURE
from clothkit.evaluation.settings import EvaluatePlanningConfig
from clothkit.evaluation.tidy import PLANNING
from clothkit.runtime.errors import InputError

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
"""Columns of the tidy rows of planning that this module uses."""

MEASURES = ("error", "voxel_error")
"""Columns by which systems are compared."""

PAIRS = (*(("main", other) for other in ("b1", "b2", "b3", "b4", "b5", "unrefined")), ("b4", "b5"))
"""Pairs of systems that are compared, as in section 6.3."""

LARGE = 0.05
"""Error above which an outcome or an estimate is called wrong [cloth length]."""

REVERSED = 0.25
"""Fraction of layers in another order above which the folds are in another order.

The fraction is one half if a cloth is folded twice, over the two axes in the other order."""


def read(folder: Path, settings: EvaluatePlanningConfig) -> pd.DataFrame:
    """Read the rows of all systems, `<folder>/<system>.parquet` each, and concatenate them.

    Raises InputError for a file that does not match the declared table, or that holds rows of another system.
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
    """Compare all PAIRS by all MEASURES with `compare`, leaving out pairs of which a system has no rows."""
    present = set(tidy["system"])
    found = [compare(tidy, measure, *pair) for measure in MEASURES for pair in PAIRS if present.issuperset(pair)]
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame(columns=list(COLUMNS))


def intervals(tidy: pd.DataFrame) -> pd.DataFrame:
    """Return means over tasks with 95 % bootstrap intervals over sequences, by split, system and column of the tables.

    The columns are split, system, measure (error [cloth length], voxel_error [mean voxel difference], and
    voxel_error_025 if the rows have it), column (length/start, or length/all), sequences, mean, low and high (NaN for
    fewer sequences than `comparisons.LEAST`).
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
    """Return causes of failure from every session's first plan, a row per split, system and length (1, 2, 3, all).

    The columns, NaN where a system lacks the value:

    - tasks: number of tasks;
    - search_failure: fraction of plans with a larger loss than the recorded manipulations, which the search missed;
    - model_failure: fraction of plans with at most the loss of the recorded manipulations, but an error above LARGE;
    - layers_reversed: fraction of tasks whose outcome has the goal's folds, but more than REVERSED of its layers in
      another order;
    - grasp_offered: fraction of starts with a candidate at every recorded grasp point;
    - nulls_fired: mean number of manipulations per session that the null check cancelled;
    - nulls_helped: among those in a session's last step, the fraction that would have led away from the goal;
    - expected, error: mean errors that the nets expected, and that the outcomes have [cloth length];
    - error_estimate_good, error_estimate_bad: mean errors of tasks whose first estimate has an error up to LARGE, and
      above it.
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
    """Return each task's cause of failure, in the words of section 6.4: the first one in this list that holds.

    - grasp point not offered: there is no candidate near a recorded grasp point;
    - estimate wrong: the first estimate has an error above LARGE;
    - estimate's layers reversed: more than REVERSED of the estimate's layers are in another order;
    - layers reversed: the same for the outcome's layers;
    - search failure: the recorded manipulations have a smaller loss than the plan;
    - model failure: the nets expected an error up to LARGE, but the outcome's is above it;
    - open: none of these.
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
