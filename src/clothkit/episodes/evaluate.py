"""Runs the sessions of all tasks of a system and saves them in pieces, so that an interrupted run can resume."""

import json
from collections import defaultdict
from pathlib import Path
from typing import TypedDict

from tqdm import tqdm

from clothkit.dataset.store import Dataset
from clothkit.dataset.tasks import Task, tasks_of
from clothkit.episodes.record import Pieces, Sessions, join, load_piece, save_piece, tasks_of_dataset
from clothkit.episodes.session import Clock, Execute, run_sessions
from clothkit.errors import InputError
from clothkit.json_file import read_json
from clothkit.planning.planner import Planner
from clothkit.planning.settings import PlanConfig
from clothkit.resumable import Storage, resumable_map


def pieces(dataset: Dataset, settings: PlanConfig) -> list[tuple[str, list[Task]]]:
    """Split name and tasks of each piece: all tasks of `settings.together` sequences.

    The pieces cover the first `settings.test` test and `settings.train` training sequences that are marked for
    evaluation. Raises InputError if the dataset has fewer.
    """
    found = []
    for split, count in (("test", settings.test), ("train", settings.train)):
        sequences = dataset.indices(split, evaluated=True)
        if len(sequences) < count:
            raise InputError(f"plan.{split}: {count} sequences, but the dataset has {len(sequences)} for evaluation")
        for first in range(0, count, settings.together):
            chosen = sequences[:count][first : first + settings.together]
            found.append((split, [task for s in chosen.tolist() for task in tasks_of(s, int(dataset.length[s]))]))
    return found


def evaluate(dataset: Dataset, planner: Planner, execute: Execute, *, work: Path) -> tuple[Pieces, Clock]:
    """Run the sessions of all tasks, except those that an earlier run has saved in the folder `work`.

    Returns all sessions, which are read from `work` piece by piece so that memory does not grow with the number of
    tasks, and the times that searches and estimates took.
    """
    todo = pieces(dataset, planner.settings)
    # Raises InputError now, not hours later, if a plan length has no reference values.
    planner.normalisation.reference(max(task.length for _, tasks in todo for task in tasks))
    paths, clock = [], defaultdict[str, list[tuple[int, float]]](list)
    with tqdm(total=sum(len(tasks) for _, tasks in todo), desc=planner.system.name, unit="session") as bar:
        finished = resumable_map(
            lambda piece: run_sessions(tasks_of_dataset(dataset, piece[1], piece[0]), planner, execute),
            todo,
            folder=work,
            name="sessions",
            storage=TIMED_SESSIONS,
            bar=bar,
            count=lambda piece: len(piece[0]),
        )
        for path, (_, calls) in finished:
            paths.append(path / SESSIONS)
            for kind, of_piece in calls.items():
                clock[kind] += of_piece
    return Pieces(paths), dict(clock)


SESSIONS, SECONDS = "sessions.npz", "seconds.json"
"""Files of a piece: its sessions, and the clock of its searches and estimates."""


def _save(folder: Path, piece: tuple[Sessions, Clock]) -> None:
    sessions, calls = piece
    folder.mkdir()
    save_piece(folder / SESSIONS, sessions)
    (folder / SECONDS).write_text(json.dumps(calls))


def _load(folder: Path) -> tuple[Sessions, Clock]:
    calls = read_json(folder / SECONDS, expected="the seconds of calls")
    pairs = {kind: [(int(count), float(seconds)) for count, seconds in found] for kind, found in calls.items()}
    return load_piece(folder / SESSIONS), pairs


TIMED_SESSIONS = Storage(_save, _load)
"""Storage of a piece in a work directory, as a folder of two files."""


def try_out(
    dataset: Dataset, sequences: list[int], split: str, planner: Planner, execute: Execute
) -> tuple[Sessions, Clock]:
    """Run the sessions of all tasks of some sequences without saving them, for studies; returns sessions and times.

    As in the plan stage, the tasks of `settings.together` sequences run as one batch.
    """
    done, clock = [], defaultdict[str, list[tuple[int, float]]](list)
    for first in range(0, len(sequences), planner.settings.together):
        chosen = sequences[first : first + planner.settings.together]
        tasks = [task for sequence in chosen for task in tasks_of(sequence, int(dataset.length[sequence]))]
        sessions, calls = run_sessions(tasks_of_dataset(dataset, tasks, split), planner, execute)
        done.append(sessions)
        for what, of_sequence in calls.items():
            clock[what] += of_sequence
    return join(done), dict(clock)


class Cost(TypedDict):
    """Numbers of searches and estimates with their total times, as pairs of count and seconds."""

    plans: dict[str, tuple[int, float]]
    """Searches by plan length."""
    estimates: tuple[int, float]


def cost(clock: Clock) -> Cost:
    """The total counts and times of a clock.

    The first call of each kind, which includes compilation, is excluded unless it is the only one.
    """
    counted = {}
    for what, calls in clock.items():
        kept = calls[1:] or calls
        counted[what] = (sum(count for count, _ in kept), round(sum(seconds for _, seconds in kept), 3))
    return Cost(estimates=counted.pop("estimates", (0, 0.0)), plans=counted)
