"""What the rows of a study were made with: those of other nets, data or settings are not taken for its own."""

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pandas as pd

NAME = "made_with"


def made_with(paths: Iterable[Path], *settings: Any) -> str:
    """A name for artifacts, files and folders, and for settings (by their reprs): twelve hexadecimal digits."""
    digest = hashlib.sha256(repr(settings).encode())
    for path in paths:
        for file in sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]:
            digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def read(path: Path, columns: list[str], of: str) -> pd.DataFrame:
    """The rows that are there already and were made with the same; none, with some columns, if none were."""
    # As text: some digests look like numbers.
    table = pd.read_csv(path, dtype={NAME: str}) if path.exists() else pd.DataFrame(columns=[*columns, NAME])
    return table[table[NAME] == of] if NAME in table else table[:0]


def joined(table: pd.DataFrame, found: pd.DataFrame) -> pd.DataFrame:
    """Rows below those that there are; numbers stay numbers, even below none."""
    return pd.concat([table, found], ignore_index=True) if len(table) else found.reset_index(drop=True)
