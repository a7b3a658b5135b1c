"""Runs the sessions of all tasks of a system and saves them in pieces, so that an interrupted run can resume."""

import json
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import TypedDict

from tqdm import tqdm

from clothkit.dataset.store import Dataset
from clothkit.dataset.tasks import Task, tasks_of
from clothkit.episodes.record import Pieces, Sessions, Tasks, join, load_piece, save_piece, tasks_of_dataset
from clothkit.episodes.sensors import Sensor
from clothkit.episodes.sessions import Execute, run_sessions
from clothkit.planning.planner import Planner
from clothkit.planning.settings import PlanConfig
from clothkit.runtime.clock import Clock, clock
from clothkit.runtime.errors import InputError
from clothkit.runtime.json_file import read_json
from clothkit.runtime.resumable import Storage, resumable_map


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


Annotate = Callable[[Sessions, Tasks], Sessions]
"""Adds to the record of a batch's sessions what only someone who knows the truth can tell (evaluation.diagnosis)."""


def evaluate(
    dataset: Dataset,
    planner: Planner,
    execute: Execute,
    *,
    work: Path,
    sensor: Sensor | None = None,
    annotate: Annotate = lambda sessions, tasks: sessions,
    refined: bool = True,
) -> tuple[Pieces, Clock]:
    """Run the sessions of all tasks, except those that an earlier run has saved in the folder `work`.

    Without a `sensor`, the planner observes exactly; `refined` is as in `run_sessions`. Returns all sessions, which are
    read from `work` piece by piece so that memory does not grow with the number of tasks, and the times that searches
    and estimates took.
    """
    todo = pieces(dataset, planner.settings)
    # Raises InputError now, not hours later, if a plan length has no reference values.
    planner.normalisation.reference(max(task.length for _, tasks in todo for task in tasks))

    def run(piece: tuple[str, list[Task]]) -> tuple[Sessions, Clock]:
        split, tasks = piece
        batch = tasks_of_dataset(dataset, tasks, split)
        with clock() as calls:
            sessions = run_sessions(batch, planner, execute, sensor=sensor, refined=refined)
        return annotate(sessions, batch), calls

    paths, times = [], defaultdict[str, list[tuple[int, float]]](list)
    with tqdm(total=sum(len(tasks) for _, tasks in todo), desc=planner.system.name, unit="session") as bar:
        finished = resumable_map(
            run,
            todo,
            folder=work,
            name="sessions",
            storage=TIMED_SESSIONS,
            bar=bar,
            count=lambda piece: len(piece[0]),
        )
        for path, (_, calls) in finished:
            paths.append(path / SESSIONS)
            for part, of_piece in calls.items():
                times[part] += of_piece
    return Pieces(paths), dict(times)


SESSIONS, SECONDS = "sessions.npz", "seconds.json"
"""Files of a piece: its sessions, and the times of its searches and estimates."""


def _save(folder: Path, piece: tuple[Sessions, Clock]) -> None:
    sessions, calls = piece
    folder.mkdir()
    save_piece(folder / SESSIONS, sessions)
    (folder / SECONDS).write_text(json.dumps(calls))


def _load(folder: Path) -> tuple[Sessions, Clock]:
    calls = read_json(folder / SECONDS, expected="the seconds of calls")
    pairs = {part: [(int(count), float(seconds)) for count, seconds in found] for part, found in calls.items()}
    return load_piece(folder / SESSIONS), pairs


TIMED_SESSIONS = Storage(_save, _load)
"""Storage of a piece in a work directory, as a folder of two files."""


def try_out(
    dataset: Dataset,
    sequences: list[int],
    split: str,
    planner: Planner,
    execute: Execute,
    *,
    annotate: Annotate = lambda sessions, tasks: sessions,
) -> tuple[Sessions, Clock]:
    """Run the sessions of all tasks of some sequences without saving them, for studies; returns sessions and times.

    As in the plan stage, the tasks of `settings.together` sequences run as one batch.
    """
    done = []
    with clock() as times:
        for first in range(0, len(sequences), planner.settings.together):
            chosen = sequences[first : first + planner.settings.together]
            tasks = [task for sequence in chosen for task in tasks_of(sequence, int(dataset.length[sequence]))]
            batch = tasks_of_dataset(dataset, tasks, split)
            done.append(annotate(run_sessions(batch, planner, execute), batch))
    return join(done), dict(times)


class Cost(TypedDict):
    """Numbers of searches and estimates with their total times, as pairs of count and seconds."""

    plans: dict[str, tuple[int, float]]
    """Searches by plan length."""
    estimates: tuple[int, float]


def cost(times: Clock) -> Cost:
    """The total counts and times of a clock.

    The first call of each kind, which includes compilation, is excluded unless it is the only one.
    """
    counted = {}
    for what, calls in times.items():
        kept = calls[1:] or calls
        counted[what] = (sum(count for count, _ in kept), round(sum(seconds for _, seconds in kept), 3))
    return Cost(estimates=counted.pop("estimates", (0, 0.0)), plans=counted)
