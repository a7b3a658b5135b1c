"""Tables of errors by a depth camera's view and noise: group-bys of tidy rows, the condition without a camera first."""

import numpy as np
import pandas as pd

from clothkit.report.layout import BY_LENGTH, NO_ACTION

KEYS = ["condition", "tilt", "noise"]


def estimation(tidy: pd.DataFrame) -> pd.DataFrame:
    """Means of observations and estimates by condition.

    Columns: condition, tilt [degrees], noise, states (number), seen (share of states), voxel_error, centre_error and
    estimate (error of the estimate) [cloth length], iou, alarm (share of the states that are seen).
    """
    groups = tidy.assign(seen=tidy["seen"].astype(float)).groupby(KEYS, sort=False)
    found = groups[["seen", "voxel_error", "centre_error", "iou", "error"]].mean()
    seen = tidy[tidy["seen"]]
    found["alarm"] = seen["alarm"].astype(float).groupby([seen[key] for key in KEYS], sort=False).mean()
    found.insert(0, "states", groups.size())
    return _degrees(found.reset_index().rename(columns={"error": "estimate"}))


def planning(tidy: pd.DataFrame) -> pd.DataFrame:
    """Means of planning outcomes for the same tasks by condition, and a last row without any action.

    Columns: condition, tilt [degrees], noise, tasks (number); 1, 2, 3 (error of outcomes by plan length [cloth
    length]); iou, iou_seen.
    """
    lengths = sorted(tidy["length"].unique())
    groups = tidy.groupby(KEYS, sort=False)
    found = pd.DataFrame({"tasks": groups.size()})
    for length in lengths:
        found[str(length)] = tidy[tidy["length"] == length].groupby(KEYS, sort=False)["error"].mean()
    found[["iou", "iou_seen"]] = groups[["iou", "iou_seen"]].mean()
    first = tidy[tidy["condition"] == tidy["condition"].iloc[0]]
    nothing: dict[str, object] = {"condition": NO_ACTION, "tilt": np.nan, "noise": np.nan, "tasks": len(first)}
    for length in lengths:
        nothing[str(length)] = first.loc[first["length"] == length, "error_no_action"].mean()
    nothing |= {"iou": first["iou_no_action"].mean(), "iou_seen": np.nan}
    return _degrees(pd.concat([found.reset_index(), pd.DataFrame([nothing])], ignore_index=True))


def comparisons(tidy: pd.DataFrame) -> pd.DataFrame:
    """Every condition compared with no camera, by length: condition, column, sequences, difference, low, high, p."""
    chosen = tidy[tidy["column"].isin(list(BY_LENGTH))]
    named = chosen.rename(columns={"system": "condition"})
    return named[["condition", "column", "sequences", "difference", "low", "high", "p"]].reset_index(drop=True)


def _degrees(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(tilt=np.degrees(table["tilt"]))
