"""Reads tidy rows and says in one sentence what is wrong with them."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from clothkit.errors import InputError

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
    "voxel_error",
    "voxel_error_no_action",
)
CALIBRATION = ("split", "system", "length", "axis", "z", "expected", "coverage")
PLANNING = ("split", "system", "sequence", "start", "length", "error", "error_no_action")

COMPARISONS = ("split", "measure", "system", "against", "column", "sequences", "difference", "low", "high", "p")

VOXEL_SYSTEMS = ("a2",)
"""Systems that predict voxels: they have no error in cloth lengths."""

_NUMBERS = ("error", "error_no_action", "voxel_error", "voxel_error_no_action")

HISTORY = ("iteration", "score")
ATTEMPTS = ("accepted", "reason")


def read(path: Path, columns: Sequence[str]) -> pd.DataFrame:
    """The tidy rows of a parquet file.

    Raises InputError if the file can't be read, is empty, lacks one of `columns`, or holds an error that is no number;
    `error` may be missing in the rows of VOXEL_SYSTEMS alone.
    """
    try:
        rows = pd.read_parquet(path)
    except (OSError, ValueError) as reason:
        raise InputError(f"{path}: expected a parquet file of tidy rows, could not read it ({reason})") from reason
    missing = [column for column in columns if column not in rows]
    if missing:
        raise InputError(f"{path}: expected the columns {', '.join(columns)}; {', '.join(missing)} not found")
    if rows.empty:
        raise InputError(f"{path}: expected at least one row, found none")
    meshless = rows["system"].isin(VOXEL_SYSTEMS) if "system" in rows else pd.Series(False, rows.index)
    for column in _NUMBERS:
        expected = ~meshless if column == "error" else meshless | True
        if column in columns and rows.loc[expected, column].isna().any():
            raise InputError(f"{path}: column {column}: expected numbers only, found a missing value")
    return rows


def read_planning(folder: Path, systems: Sequence[str]) -> pd.DataFrame:
    """The planning rows of the given systems, `<folder>/<system>.parquet` each, one below the other."""
    return pd.concat([read(folder / f"{system}.parquet", PLANNING) for system in systems], ignore_index=True)


def require(rows: pd.DataFrame, systems: Sequence[str]) -> None:
    """Raises InputError unless every system has rows in every split that the rows are about."""
    for split in rows["split"].unique():
        present = set(rows.loc[rows["split"] == split, "system"])
        missing = [system for system in systems if system not in present]
        if missing:
            raise InputError(f"tidy rows: expected rows of system {missing[0]} in split {split}, found none")
