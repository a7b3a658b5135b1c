"""The rows of a study as CSV, with fingerprints of nets, data and settings, by which rows out of date are dropped."""

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pandas as pd

from clothkit.runtime.publish import unfinished

COLUMN = "fingerprint"
"""The column of a study's rows."""


def fingerprint(paths: Iterable[Path], *settings: Any) -> str:
    """Return twelve hexadecimal digits of a hash over artifacts (files or folders) and settings (their reprs)."""
    digest = hashlib.sha256(repr(settings).encode())
    for path in paths:
        for file in sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]:
            digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def read(path: Path, columns: list[str], current: str) -> pd.DataFrame:
    """Return the rows of a CSV file with the current fingerprint; if it is missing, an empty table with `columns`."""
    # Read as text, since some fingerprints look like numbers.
    table = pd.read_csv(path, dtype={COLUMN: str}) if path.exists() else pd.DataFrame(columns=[*columns, COLUMN])
    return table[table[COLUMN] == current] if COLUMN in table else table[:0]


def append(table: pd.DataFrame, found: pd.DataFrame) -> pd.DataFrame:
    """Return the table with the found rows appended; data types are kept if the table is empty."""
    return pd.concat([table, found], ignore_index=True) if len(table) else found.reset_index(drop=True)


def write(table: pd.DataFrame, path: Path) -> None:
    """Write rows as a CSV file, which is replaced only when it is complete."""
    with unfinished(path) as part:
        table.to_csv(part, index=False, lineterminator="\n", float_format="%.5g")
