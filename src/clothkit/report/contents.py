"""Reads a report's folder: the settings, tables and captions from which its pages are made."""

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from clothkit.report import run_settings
from clothkit.report.captions import CAPTIONS_FILE
from clothkit.report.formatting import LEAST
from clothkit.report.layout import BY_LENGTH, HIGH, LOW
from clothkit.report.run_settings import RunSettings
from clothkit.runtime.errors import InputError, system_error
from clothkit.runtime.json_file import read_json

_CAPTIONED = "a JSON object with a caption for every picture"
PLANNED = ("split", "sequences")
"""Columns of `tables/planned.csv`, the numbers of sequences that were planned for. Older reports lack it."""


COUNTS = (
    *("sequence", "start", "length", "sequences", "manipulations", "attempts", "states", "tasks", "cloths"),
    "peak_memory_mib",
)
"""Columns of counts and indices, which stay integers; other columns of numbers are read as floats."""

MEMORY = ("system", "column", "sequences", "difference", "p")
"""Columns of the study of the memory trace."""

COMPARED = ("system", "against", "column", "sequences", "difference", "p")
"""Columns of the comparisons of the study of doubt."""


@dataclass(frozen=True)
class Contents:
    """The content of the pages."""

    settings: RunSettings
    tables: Mapping[str, pd.DataFrame]
    """The tables that exist, by name; intervals and p from fewer than `LEAST` sequences are NaN."""
    figures: Mapping[str, str]
    """The captions of the pictures that exist, by name."""
    drawn: frozenset[str]
    """Paths in the report's folder of the studies' pictures that exist."""
    planned: Mapping[str, int]
    """Number of sequences that were planned for, by split."""
    memory: pd.DataFrame | None
    """The study of the memory trace's effect (studies/memory.py), if there is one."""
    doubt: pd.DataFrame | None
    """Planners with and without doubt compared on more test sequences (studies/doubt.py), if they are."""


def read(
    folder: Path, columns: Mapping[str, tuple[str, ...]], captions: Mapping[str, str], studies: Collection[str] = ()
) -> Contents:
    """The contents of reports/<scale>/. Raises InputError for a file that can't be read or lacks a column.

    `columns` are those that each table must have, by its path in the folder; `captions` are those of figures, by name;
    `studies` are paths of the studies' pictures.
    """
    settings = run_settings.read(folder / "params.yaml")
    paths = {folder / path: needed for path, needed in {**columns, "tables/planned.csv": PLANNED}.items()}
    tables = {path.stem: _table(path, needed) for path, needed in paths.items() if path.exists()}
    if "table_6" not in tables:
        raise InputError(f"{folder}/tables/table_6.csv: not found; run the stage that writes it (dvc repro report)")
    planned = _planned(tables, settings)
    return Contents(
        settings=settings,
        tables={name: enough(table, planned) for name, table in tables.items()},
        figures=_figures(folder / "figures", captions),
        drawn=frozenset(path for path in studies if (folder / path).is_file()),
        planned=planned,
        memory=_study(folder / "studies/memory.csv", MEMORY),
        doubt=_study(folder / "studies/doubt_test_comparisons.csv", COMPARED),
    )


def _study(path: Path, columns: tuple[str, ...]) -> pd.DataFrame | None:
    return _table(path, columns) if path.is_file() else None


def enough(table: pd.DataFrame, planned: Mapping[str, int]) -> pd.DataFrame:
    """The table with NaN in place of intervals and p from fewer than `LEAST` sequences.

    Comparisons have a column with their number of sequences. For tables 6 and 7 it is `planned`, by split.
    """
    if {"sequences", "low", "high", "p"} <= set(table.columns):
        few = table["sequences"] < LEAST
        return table.assign(**{name: table[name].where(~few) for name in ("low", "high", "p")})
    if {"split", "statistic"} <= set(table.columns):
        few = table["statistic"].isin([LOW, HIGH]) & table["split"].map(lambda split: planned.get(split, 0) < LEAST)
        figures = table.columns.difference(["source", "split", "system", "kind", "statistic"])
        return table.assign(**{name: table[name].mask(few) for name in figures})
    return table


def _figures(folder: Path, captions: Mapping[str, str]) -> dict[str, str]:
    """Captions of the pictures that exist: those stored with the pictures, or today's if none were stored."""
    path = folder / CAPTIONS_FILE
    try:
        stored = read_json(path, expected=_CAPTIONED) if os.path.lexists(path) else captions
        return {name: str(stored[name]) for name in captions if (folder / f"{name}.png").exists()}
    except KeyError as error:
        raise InputError(f"{path}: expected {_CAPTIONED}; {error!r}") from error


def _planned(tables: Mapping[str, pd.DataFrame], settings: RunSettings) -> dict[str, int]:
    """Number of sequences that were planned for, by split.

    Older reports lack the table `planned`. For these, the number is that of the planners' comparisons or the settings.
    """
    if "planned" in tables:
        rows = tables["planned"]
        return dict(zip(rows["split"], map(int, rows["sequences"]), strict=True))
    splits = list(dict.fromkeys(tables["table_6"].query("source == 'clothkit'")["split"]))
    compared = tables.get("planning_comparisons", pd.DataFrame(columns=["split", "column", "sequences"]))
    every = compared[compared["column"].isin(BY_LENGTH)].groupby("split")["sequences"].max()
    return {split: int(every.get(split, settings.sequences[split])) for split in splits}


def _table(path: Path, columns: tuple[str, ...]) -> pd.DataFrame:
    try:
        table = pd.read_csv(path, keep_default_na=False, na_values=[""])
    except OSError as error:
        raise system_error(error, path) from error
    except (ValueError, pd.errors.ParserError) as error:
        raise InputError(f"{path}: expected a table as CSV, could not read it ({error})") from error
    missing = [column for column in columns if column not in table]
    if missing:
        raise InputError(f"{path}: expected the columns {', '.join(columns)}; {', '.join(missing)} not found")
    figures = table.select_dtypes("int64").columns.difference(list(COUNTS))
    return table.astype(dict.fromkeys(figures, float))
