"""The means of all tables as tidy rows, and a selection that fits `dvc exp show` and `dvc metrics diff`."""

from collections.abc import Sequence
from typing import Any

import pandas as pd

DIGITS = 6

LENGTHS = {"1": "1/all", "2": "2/all", "3": "3/all"}
"""Columns of the tables of tasks by number of manipulations."""

OTHER_PLANNERS = 8
"""Largest number of planners beside the first one in the headline figures; more than the paper has."""


def means(
    *,
    estimation: pd.DataFrame,
    prediction: pd.DataFrame,
    prediction_voxels: pd.DataFrame | None,
    position: pd.DataFrame,
    planning: pd.DataFrame,
    planning_voxels: pd.DataFrame | None,
    sigma_ratio: pd.DataFrame,
) -> pd.DataFrame:
    """A row for each of our means: measure, split, system (for estimates the kind), column of the table, mean.

    Means are errors [cloth length] or differences of voxels; for sigma ratios they are medians. Missing means have no
    row.
    """
    by_system = {
        "prediction": prediction,
        "position": position,
        "prediction_voxels": prediction_voxels,
        "planning": planning,
        "planning_voxels": planning_voxels,
    }
    parts = {"estimation": _means(estimation.rename(columns={"kind": "system"}))}
    parts |= {measure: _means(table) for measure, table in by_system.items() if table is not None}
    ratios = sigma_ratio[sigma_ratio["source"] == "clothkit"]
    parts["sigma_ratio"] = _long(ratios.drop(columns="source"))
    rows = pd.concat([part.assign(measure=measure) for measure, part in parts.items()], ignore_index=True)
    return rows[["measure", "split", "system", "column", "mean"]]


def headline(rows: pd.DataFrame, planners: Sequence[str]) -> dict[str, Any]:
    """At most 20 figures of the test split from the rows of `means`, as nested dictionaries.

    They are errors of estimates, of main's predictions and of the first planner's plans by number of manipulations, of
    the other planners' plans of three manipulations, and main's sigma ratios.
    """
    test = rows[rows["split"] == "test"].set_index(["measure", "system", "column"])["mean"].round(DIGITS).to_dict()

    def of(measure: str, cells: dict[str, tuple[str, str]]) -> dict[str, float]:
        return {name: test[measure, *cell] for name, cell in cells.items() if (measure, *cell) in test}

    first, *others = planners
    lengths = {first: LENGTHS} | {system: {"3": LENGTHS["3"]} for system in others[:OTHER_PLANNERS]}
    planning = {
        system: of("planning", {length: (system, column) for length, column in columns.items()})
        for system, columns in lengths.items()
    }
    return {
        "estimation": of("estimation", {kind: (kind, "all") for kind in ("pmr", "dmr")}),
        "prediction": of("prediction", {length: ("main", column) for length, column in LENGTHS.items()}),
        "planning": {system: found for system, found in planning.items() if found},
        "sigma_ratio": of("sigma_ratio", {name: ("main", name) for name in ("estimate", *LENGTHS)}),
    }


def _means(table: pd.DataFrame) -> pd.DataFrame:
    ours = table[(table["source"] == "clothkit") & (table["statistic"] == "mean")]
    return _long(ours.drop(columns=["source", "statistic"]))


def _long(table: pd.DataFrame) -> pd.DataFrame:
    return table.melt(["split", "system"], var_name="column", value_name="mean").dropna(subset=["mean"])
