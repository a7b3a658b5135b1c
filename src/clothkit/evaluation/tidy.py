"""Reads tidy rows, and says in one sentence what is wrong with a file that holds none."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from clothkit.errors import InputError


def read(path: Path, columns: Sequence[str], *, may_be_empty: bool = False) -> pd.DataFrame:
    """The tidy rows of a parquet file. Raises InputError if it can't be read, is empty or lacks one of `columns`."""
    try:
        rows = pd.read_parquet(path)
    except (OSError, ValueError) as reason:
        raise InputError(f"{path}: expected a parquet file of tidy rows, could not read it ({reason})") from reason
    missing = [column for column in columns if column not in rows]
    if missing:
        raise InputError(f"{path}: expected the columns {', '.join(columns)}; {', '.join(missing)} not found")
    if rows.empty and not may_be_empty:
        raise InputError(f"{path}: expected at least one row, found none")
    return rows
