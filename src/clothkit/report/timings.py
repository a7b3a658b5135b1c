"""Time and memory of stages, and time per plan, from the notes that the stages leave in `.work/timings`."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from clothkit.report import paper
from clothkit.runtime.errors import InputError
from clothkit.runtime.json_file import read_json

COLUMNS = ["stage", "seconds", "cpu_seconds", "peak_memory_mib", "machine"]

LENGTHS = ("1", "2", "3")


def timings(folder: Path) -> pd.DataFrame:
    """A row per stage that left a note: seconds [s], cpu_seconds [s], peak_memory_mib [MiB], machine.

    A stage that was restored from the cache leaves no note. Raises InputError for a note that is no JSON object with
    these fields.
    """
    notes = []
    for path in sorted(folder.glob("*.json")):
        note = _note(path)
        try:
            notes.append({column: note[column] for column in COLUMNS})
        except KeyError as reason:
            raise InputError(f"{path}: expected a JSON object with {', '.join(COLUMNS)}; {reason!r}") from reason
    return pd.DataFrame(notes, columns=COLUMNS)


def table_8(folder: Path, systems: Sequence[str]) -> pd.DataFrame:
    """Table 8: seconds of search per plan, by system and plan length, with the paper's rows below ours.

    Columns: source, system, machine, 1, 2, 3 [s], estimate (time per estimate of a mesh [s]; the paper's is from
    section 6.1). NaN where a stage has left no note, or has planned or estimated nothing. Raises InputError for a note
    whose `plans` or `estimates` are not [count, seconds].
    """
    own = []
    for system in systems:
        row: dict[str, Any] = {"source": "clothkit", "system": system, "machine": ""}
        path = folder / f"plan@{system}.json"
        if os.path.lexists(path):
            note = _note(path)
            plans = note.get("plans", {})
            if not isinstance(plans, dict):
                raise InputError(f"{path}: plans: expected an object by plan length, found {plans!r}")
            row |= {"machine": note.get("machine", "")}
            row |= {length: _each(path, f"plans.{length}", plans.get(length)) for length in LENGTHS}
            row |= {"estimate": _each(path, "estimates", note.get("estimates"))}
        own.append(row)
    table = pd.DataFrame(own, columns=["source", "system", "machine", *LENGTHS, "estimate"])
    return pd.concat(
        [table.astype(dict.fromkeys((*LENGTHS, "estimate"), float)), paper.table_of(8, systems)], ignore_index=True
    )


def _note(path: Path) -> dict[str, Any]:
    return read_json(path, expected=f"a JSON object with {', '.join(COLUMNS)}")


def _each(path: Path, field: str, cost: Any) -> float:
    """Mean time per item from [count, seconds] in a note [s]; NaN without items."""
    if cost is None:
        return float("nan")
    try:
        count, seconds = map(float, cost)
    except (TypeError, ValueError) as reason:
        raise InputError(f"{path}: {field}: expected [count, seconds], found {cost!r}") from reason
    return seconds / count if count else float("nan")
