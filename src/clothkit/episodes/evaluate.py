"""Runs the sessions of all tasks of a system and saves them in pieces, so that an interrupted run can resume."""

import json
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import TypedDict

from tqdm import tqdm

from clothkit.clock import Clock, clock
from clothkit.dataset.store import Dataset
from clothkit.dataset.tasks import Task, tasks_of
from clothkit.episodes.record import Pieces, Sessions, Tasks, join, save_piece, tasks_of_dataset
from clothkit.episodes.sensors import Sensor
from clothkit.episodes.sessions import Execute, run_sessions
from clothkit.errors import InputError
from clothkit.json_file import read_json
from clothkit.planning.planner import Planner
from clothkit.planning.settings import PlanConfig


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
) -> tuple[Pieces, Clock]:
    """Run the sessions of all tasks, except those that an earlier run has saved in the folder `work`.

    Without a `sensor`, the planner observes exactly. Returns all sessions, which are read from `work` piece by piece so
    that memory does not grow with the number of tasks, and the times that searches and estimates took.
    """
    work.mkdir(parents=True, exist_ok=True)
    todo = pieces(dataset, planner.settings)
    # Raises InputError now, not hours later, if a plan length has no reference values.
    planner.normalisation.reference(max(task.length for _, tasks in todo for task in tasks))
    done, times = [], defaultdict[str, list[tuple[int, float]]](list)
    with tqdm(total=sum(len(tasks) for _, tasks in todo), desc=planner.system.name, unit="session") as bar:
        for number, (split, tasks) in enumerate(todo):
            path, seconds = work / f"sessions_{number:03d}.npz", work / f"seconds_{number:03d}.json"
            if not path.exists():
                batch = tasks_of_dataset(dataset, tasks, split)
                with clock() as calls:
                    sessions = run_sessions(batch, planner, execute, sensor=sensor)
                seconds.write_text(json.dumps(calls))
                save_piece(path, annotate(sessions, batch))
            done.append(path)
            spent = read_json(seconds, expected="seconds of calls (delete this file and the sessions of its number)")
            for what, of_piece in spent.items():
                times[what] += [(count, each) for count, each in of_piece]
            bar.update(len(tasks))
    return Pieces(done), dict(times)


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
