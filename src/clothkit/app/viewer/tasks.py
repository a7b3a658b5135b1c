"""Tasks for live sessions: your own files, or test tasks of the dataset."""

import os
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from clothkit.dataset.store import SPLITS, load_splits
from clothkit.dataset.tasks import tasks_of


class SessionFiles(NamedTuple):
    """The task of a session, as files."""

    state: str
    """A file, in the notation of the commands; so is `goal`."""
    goal: str
    steps: int | Literal["auto"]
    """The number of manipulations, or that the agent chooses."""
    mask: str | None = None


MOST = 50
"""Number of sequences that are offered; a list of all would be too long."""


def test_tasks(path: Path) -> dict[str, SessionFiles]:
    """Return the test tasks of a store of meshes, by name; none if there is no store. Raises InputError."""
    if not os.path.lexists(path):
        return {}
    split, length = load_splits(path)
    sequences = np.flatnonzero(split == SPLITS.index("test"))[:MOST]
    return {
        f"sequence {s}, state {task.start} to {task.start + task.length}": SessionFiles(
            f"{path}:{s}/{task.start}", f"{path}:{s}/{task.start + task.length}", task.length
        )
        for s in sequences.tolist()
        for task in tasks_of(s, int(length[s]))
    }
