"""Identification of the nets, data and settings that a study's rows were made with, so that stale rows are dropped."""

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pandas as pd

NAME = "made_with"


def made_with(paths: Iterable[Path], *settings: Any) -> str:
    """Return twelve hexadecimal digits of a hash over artifacts (files or folders) and settings (their reprs)."""
    digest = hashlib.sha256(repr(settings).encode())
    for path in paths:
        for file in sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]:
            digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def read(path: Path, columns: list[str], of: str) -> pd.DataFrame:
    """Return the rows of a CSV file whose digest is `of`; if the file is missing, an empty table with `columns`."""
    # The digests are read as text, since some look like numbers.
    table = pd.read_csv(path, dtype={NAME: str}) if path.exists() else pd.DataFrame(columns=[*columns, NAME])
    return table[table[NAME] == of] if NAME in table else table[:0]


def joined(table: pd.DataFrame, found: pd.DataFrame) -> pd.DataFrame:
    """Return the table with the found rows appended; data types are kept if the table is empty."""
    return pd.concat([table, found], ignore_index=True) if len(table) else found.reset_index(drop=True)
