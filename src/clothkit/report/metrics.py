"""Headline figures for `dvc metrics diff`: the means of the tables, our rows only, as nested names."""

from typing import Any

import pandas as pd

DIGITS = 6


def headline(
    *,
    estimation: pd.DataFrame,
    prediction: pd.DataFrame,
    prediction_voxels: pd.DataFrame,
    position: pd.DataFrame,
    planning: pd.DataFrame,
    planning_voxels: pd.DataFrame,
    sigma_ratio: pd.DataFrame,
) -> dict[str, Any]:
    """Means by split, kind or system, and column, no action included: errors [cloth length], voxel differences.

    Of sigma ratios the medians.
    """
    ratios = sigma_ratio[sigma_ratio["source"] == "clothkit"].drop(columns=["source", "system"])
    return {
        "estimation": _means(estimation, "kind"),
        "prediction": _means(prediction, "system"),
        "position": _means(position, "system"),
        "prediction_voxels": _means(prediction_voxels, "system"),
        "planning": _means(planning, "system"),
        "planning_voxels": _means(planning_voxels, "system"),
        "sigma_ratio": {row.pop("split"): _rounded(row) for row in ratios.to_dict("records")},
    }


def _means(table: pd.DataFrame, by: str) -> dict[str, Any]:
    means = table[(table["source"] == "clothkit") & (table["statistic"] == "mean")]
    nested: dict[str, Any] = {}
    for row in means.drop(columns=["source", "statistic"]).to_dict("records"):
        split, group = row.pop("split"), row.pop(by)
        nested.setdefault(split, {})[group] = _rounded(row)
    return nested


def _rounded(row: dict) -> dict[str, float]:
    return {str(name): round(float(value), DIGITS) for name, value in row.items() if not pd.isna(value)}
