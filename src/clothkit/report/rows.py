"""Reads tidy rows and says in one sentence what is wrong with them."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from clothkit.errors import InputError
from clothkit.evaluation import tidy

ESTIMATION = ("split", "sequence", "state", "kind", "error", "error_no_action", "sigma_ratio")
PREDICTION = (
    "split",
    "system",
    "net",
    "better",
    "sequence",
    "start",
    "length",
    "error",
    "error_no_action",
    "sigma_ratio",
    "position_error",
    "position_no_action",
    *("voxel_error", "voxel_error_no_action"),
    *("voxel_error_025", "voxel_error_025_no_action"),
)
CALIBRATION = ("split", "system", "length", "axis", "z", "expected", "coverage")
PLANNING = (
    "split",
    "system",
    "sequence",
    "start",
    "length",
    "error",
    "error_labelled",
    "error_no_action",
    "voxel_error",
    "voxel_error_no_action",
    "layers_reversed",
    "estimate_error",
    "estimate_layers_reversed",
    "expected",
    "loss",
    "loss_recorded",
    "grasp_offered",
)
VOXELS_025 = ("split", "system", "sequence", "start", "length", "voxel_error_025", "voxel_error_025_no_action")
COMPARISONS = ("split", "measure", "system", "against", "column", "sequences", "difference", "low", "high", "p")
INTERVALS = ("split", "system", "measure", "column", "sequences", "mean", "low", "high")
FAILURES = (
    "split",
    "system",
    "length",
    "tasks",
    "search_failure",
    "model_failure",
    "layers_reversed",
    "grasp_offered",
    "nulls_fired",
    "nulls_helped",
    "expected",
    "error",
    "error_estimate_good",
    "error_estimate_bad",
)

CAMERA_ESTIMATION = ("condition", "tilt", "noise", "seen", "voxel_error", "centre_error", "iou", "error")
CAMERA_PLANNING = (
    *("system", "length", "error", "error_no_action"),
    *("condition", "tilt", "noise", "iou", "iou_no_action", "iou_seen"),
)

VOXEL_SYSTEMS = ("main_occluded", "a2")
"""Systems whose predictions are voxels as a camera sees them: they have no error in cloth lengths."""

_NUMBERS = (
    *("error", "error_labelled", "error_no_action", "voxel_error", "voxel_error_no_action"),
    *("voxel_error_025", "voxel_error_025_no_action"),
)

HISTORY = ("iteration", "score")
ATTEMPTS = ("accepted", "reason")


def read(path: Path, columns: Sequence[str]) -> pd.DataFrame:
    """The tidy rows of a parquet file.

    Raises InputError if the file can't be read, is empty, lacks one of `columns`, or holds an error that is no number;
    `error` may be missing in the rows of VOXEL_SYSTEMS alone.
    """
    rows = tidy.read(path, columns)
    meshless = rows["system"].isin(VOXEL_SYSTEMS) if "system" in rows else pd.Series(False, rows.index)
    for column in _NUMBERS:
        expected = ~meshless if column == "error" else meshless | True
        if column in columns and rows.loc[expected, column].isna().any():
            raise InputError(f"{path}: column {column}: expected numbers only, found a missing value")
    return rows


def read_planning(folder: Path, systems: Sequence[str]) -> pd.DataFrame:
    """The planning rows of the given systems, `<folder>/<system>.parquet` each, one below the other, and beside them
    those of `<folder>/voxels_025.parquet`.

    Raises InputError, as `read` does, and where a task has no row or two in the latter.
    """
    rows = pd.concat([read(folder / f"{system}.parquet", PLANNING) for system in systems], ignore_index=True)
    path = folder / "voxels_025.parquet"
    tall = read(path, VOXELS_025)
    tasks = list(VOXELS_025[:5])
    if len(rows.merge(tall, on=tasks)) != len(rows):
        raise InputError(f"{path}: expected one row for each task of the planning rows, found none or two for some")
    return rows.merge(tall, on=tasks)


def read_comparisons(path: Path) -> pd.DataFrame:
    """Paired comparisons; none where there was only one system to compare."""
    return tidy.read(path, COMPARISONS, may_be_empty=True)


def require(rows: pd.DataFrame, systems: Sequence[str]) -> None:
    """Raises InputError unless every system has rows in every split that the rows are about."""
    for split in rows["split"].unique():
        present = set(rows.loc[rows["split"] == split, "system"])
        missing = [system for system in systems if system not in present]
        if missing:
            raise InputError(f"tidy rows: expected rows of system {missing[0]} in split {split}, found none")
