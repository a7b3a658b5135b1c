"""Time and memory of every stage, from the notes that the stages leave in `.work/timings`."""

import json
from pathlib import Path

import pandas as pd

from clothkit.errors import InputError

COLUMNS = ["stage", "seconds", "cpu_seconds", "peak_memory_mib", "machine"]


def timings(folder: Path) -> pd.DataFrame:
    """A row per stage that left a note: seconds [s], cpu_seconds [s], peak_memory_mib [MiB], machine.

    A stage that was restored from the cache leaves none. Raises InputError for a note that is no such JSON object.
    """
    notes = []
    for path in sorted(folder.glob("*.json")):
        try:
            note = json.loads(path.read_text())
            notes.append({column: note[column] for column in COLUMNS})
        except (ValueError, KeyError, TypeError) as reason:
            raise InputError(f"{path}: expected a JSON object with {', '.join(COLUMNS)}; {reason!r}") from reason
    return pd.DataFrame(notes, columns=COLUMNS)
