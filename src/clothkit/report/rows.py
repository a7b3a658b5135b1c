"""Reads the tidy rows of planning and checks that no system is missing."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from clothkit.dataset import tables
from clothkit.evaluation import tidy
from clothkit.evaluation.tidy import VOXEL_SYSTEMS as VOXEL_SYSTEMS
from clothkit.runtime.errors import InputError


def read_planning(folder: Path, systems: Sequence[str]) -> pd.DataFrame:
    """The planning rows of the given systems from `<folder>/<system>.parquet`, with the columns of voxels_025.parquet.

    Raises InputError for a malformed file, and when a task has no row in `<folder>/voxels_025.parquet`.
    """
    rows = pd.concat(
        [tables.read(folder / f"{system}.parquet", tidy.PLANNING) for system in systems], ignore_index=True
    )
    path = folder / "voxels_025.parquet"
    joined = rows.merge(tables.read(path, tidy.VOXELS_025), on=list(tidy.VOXELS_025.keys))
    if len(joined) != len(rows):
        raise InputError(f"{path}: expected a row for each task of the planning rows, found none for some")
    return joined


def require(rows: pd.DataFrame, systems: Sequence[str]) -> None:
    """Raises InputError unless every system has rows in every split that occurs in `rows`."""
    for split in rows["split"].unique():
        present = set(rows.loc[rows["split"] == split, "system"])
        missing = [system for system in systems if system not in present]
        if missing:
            raise InputError(f"tidy rows: expected rows of system {missing[0]} in split {split}, found none")
