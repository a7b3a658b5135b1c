"""Sessions for all tasks of a system, kept piece by piece so that an interrupted run goes on."""

import json
from collections import defaultdict
from pathlib import Path
from typing import TypedDict

from tqdm import tqdm

from clothkit.dataset.store import Dataset
from clothkit.dataset.tasks import Task, tasks_of
from clothkit.errors import InputError
from clothkit.json_file import read_json
from clothkit.planning.planner import Planner
from clothkit.planning.record import Pieces, Sessions, join, save_piece, tasks_of_dataset
from clothkit.planning.session import Clock, Execute, run_sessions
from clothkit.planning.settings import PlanConfig


def pieces(dataset: Dataset, settings: PlanConfig) -> list[tuple[str, list[Task]]]:
    """All tasks of the first evaluated sequences of the test and the training split, a few sequences together."""
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
    """The sessions of every task; those that `work` holds from an earlier run are not run again.

    They stay in `work`, so that memory does not grow with the number of tasks.
    """
    work.mkdir(parents=True, exist_ok=True)
    todo = pieces(dataset, planner.settings)
    # Lengths without reference values are told now, not hours later.
    planner.normalisation.reference(max(task.length for _, tasks in todo for task in tasks))
    done, clock = [], defaultdict[str, list[tuple[int, float]]](list)
    with tqdm(total=sum(len(tasks) for _, tasks in todo), desc=planner.system.name, unit="session") as bar:
        for number, (split, tasks) in enumerate(todo):
            path, seconds = work / f"sessions_{number:03d}.npz", work / f"seconds_{number:03d}.json"
            if not path.exists():
                sessions, calls = run_sessions(tasks_of_dataset(dataset, tasks, split), planner, execute)
                seconds.write_text(json.dumps(calls))
                save_piece(path, sessions)
            done.append(path)
            spent = read_json(seconds, expected="seconds of calls (delete this file and the sessions of its number)")
            for what, of_piece in spent.items():
                clock[what] += [(count, each) for count, each in of_piece]
            bar.update(len(tasks))
    return Pieces(done), dict(clock)


def try_out(
    dataset: Dataset, sequences: list[int], split: str, planner: Planner, execute: Execute
) -> tuple[Sessions, Clock]:
    """The sessions of every task of some sequences, as many together as a stage would run: for studies."""
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
    """How many, and their seconds."""

    plans: dict[str, tuple[int, float]]
    """Searches, by plan length."""
    estimates: tuple[int, float]


def cost(clock: Clock) -> Cost:
    """What sessions cost. The first call of a kind, which compiles, is left out where there are others."""
    counted = {}
    for what, calls in clock.items():
        kept = calls[1:] or calls
        counted[what] = (sum(count for count, _ in kept), round(sum(seconds for _, seconds in kept), 3))
    return Cost(estimates=counted.pop("estimates", (0, 0.0)), plans=counted)
