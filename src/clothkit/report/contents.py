"""Reads a report's folder: the settings, tables and captions from which its pages are made."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from clothkit.errors import InputError, system_error
from clothkit.json_file import read_json
from clothkit.report import made_with
from clothkit.report.captions import CAPTIONS, CAPTIONS_FILE
from clothkit.report.layout import BY_LENGTH, HIGH, LENGTHS, LOW, STATES, TASKS
from clothkit.report.made_with import MadeWith
from clothkit.report.printed import LEAST

_CAPTIONED = "a JSON object with a caption for every picture"
_OUTCOMES = ("source", "split", "system", "statistic", *TASKS)
_COMPARED = ("column", "sequences", "difference", "low", "high", "p")

TABLES: Mapping[str, tuple[str, ...]] = {
    "table_2": ("source", "split", "kind", "statistic", *STATES),
    "table_3": _OUTCOMES,
    "table_4": _OUTCOMES,
    "table_4_025": _OUTCOMES,
    "comparisons": ("split", "measure", "system", "against", *_COMPARED),
    "table_5": ("source", "split", "system", "statistic", *LENGTHS),
    "table_6": _OUTCOMES,
    "table_7": _OUTCOMES,
    "table_7_025": _OUTCOMES,
    "planned": ("split", "sequences"),
    "planning_comparisons": ("split", "measure", "system", "against", *_COMPARED),
    "failures": ("split", "system", "length", "tasks"),
    "largest": ("sequence", "start", "length", "error", "diagnosis"),
    "camera_estimation": ("condition", "tilt", "noise", "states"),
    "camera_planning": ("condition", "tilt", "noise", "tasks"),
    "camera_comparisons": ("condition", *_COMPARED),
    "sigma_ratio": ("source", "split", "system", "estimate", *LENGTHS),
    "splits": ("split", "sequences", "manipulations", "single_handed"),
    "attempts": ("outcome", "attempts", "share"),
}
"""Every table under `tables/`, and the columns that it must have. Older reports lack some tables."""

COSTS: Mapping[str, tuple[str, ...]] = {
    "table_8": ("source", "system", "machine", *LENGTHS, "estimate"),
    "timings": ("stage", "seconds", "cpu_seconds", "peak_memory_mib", "machine"),
}
"""Tables in the report's folder itself, and the columns that they must have."""


COUNTS = (
    *("sequence", "start", "length", "sequences", "manipulations", "attempts", "states", "tasks"),
    "peak_memory_mib",
)
"""Columns of counts and indices, which stay integers; other columns of numbers are read as floats."""

MEMORY = ("system", "column", "sequences", "difference", "p")
"""Columns of the study of the memory trace."""


@dataclass(frozen=True)
class Contents:
    """The content of the pages."""

    made_with: MadeWith
    tables: Mapping[str, pd.DataFrame]
    """The tables of TABLES and COSTS that exist; intervals and p from fewer than `LEAST` sequences are NaN."""
    figures: Mapping[str, str]
    """The captions of the pictures that exist, by name."""
    planned: Mapping[str, int]
    """Number of sequences that were planned for, by split."""
    memory: pd.DataFrame | None
    """The study of the memory trace's effect (studies/memory.py), if there is one."""


def read(folder: Path) -> Contents:
    """The contents of reports/<scale>/. Raises InputError for a file that can't be read or lacks a column."""
    settings = made_with.read(folder / "params.yaml")
    paths = {folder / "tables" / f"{name}.csv": columns for name, columns in TABLES.items()}
    paths |= {folder / f"{name}.csv": columns for name, columns in COSTS.items()}
    tables = {path.stem: _table(path, columns) for path, columns in paths.items() if path.exists()}
    if "table_6" not in tables:
        raise InputError(f"{folder}/tables/table_6.csv: not found; run the stage that writes it (dvc repro report)")
    planned = _planned(tables, settings)
    return Contents(
        made_with=settings,
        tables={name: enough(table, planned) for name, table in tables.items()},
        figures=_figures(folder / "figures"),
        planned=planned,
        memory=_table(study, MEMORY) if (study := folder / "studies/memory.csv").is_file() else None,
    )


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


def _figures(folder: Path) -> dict[str, str]:
    """Captions of the pictures that exist: those stored with the pictures, or today's if none were stored."""
    path = folder / CAPTIONS_FILE
    try:
        told = read_json(path, expected=_CAPTIONED) if os.path.lexists(path) else CAPTIONS
        return {name: str(told[name]) for name in CAPTIONS if (folder / f"{name}.png").exists()}
    except KeyError as error:
        raise InputError(f"{path}: expected {_CAPTIONED}; {error!r}") from error


def _planned(tables: Mapping[str, pd.DataFrame], settings: MadeWith) -> dict[str, int]:
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
