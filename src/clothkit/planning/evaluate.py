"""Sessions for all tasks of a system, kept piece by piece so that an interrupted run goes on."""

from pathlib import Path

from tqdm import tqdm

from clothkit.dataset.store import Dataset
from clothkit.dataset.tasks import tasks_of
from clothkit.errors import InputError
from clothkit.planning.record import Sessions, Tasks, join, load_piece, save_piece, tasks_of_dataset
from clothkit.planning.session import Execute, Planner, run_sessions
from clothkit.planning.settings import PlanConfig


def pieces(dataset: Dataset, settings: PlanConfig) -> list[Tasks]:
    """All tasks of the first evaluated sequences of the test and the training split, a few sequences together."""
    found = []
    for split, count in (("test", settings.test), ("train", settings.train)):
        sequences = dataset.indices(split, evaluated=True)
        if len(sequences) < count:
            raise InputError(f"plan.{split}: {count} sequences, but the dataset has {len(sequences)} for evaluation")
        for first in range(0, count, settings.together):
            chosen = sequences[:count][first : first + settings.together]
            tasks = [task for s in chosen.tolist() for task in tasks_of(s, int(dataset.length[s]))]
            found.append(tasks_of_dataset(dataset, tasks, split))
    return found


def evaluate(dataset: Dataset, planner: Planner, execute: Execute, *, work: Path) -> Sessions:
    """The sessions of every task; those that `work` holds from an earlier run are not run again."""
    work.mkdir(parents=True, exist_ok=True)
    todo = pieces(dataset, planner.settings)
    # Lengths without reference values are told now, not hours later.
    planner.normalisation.reference(max(task.length for piece in todo for task in piece.task))
    done = []
    with tqdm(total=sum(len(piece.task) for piece in todo), desc=planner.system.name, unit="session") as bar:
        for number, piece in enumerate(todo):
            path = work / f"sessions_{number:03d}.npz"
            if not path.exists():
                save_piece(path, run_sessions(piece, planner, execute))
            done.append(load_piece(path))
            bar.update(len(piece.task))
    return join(done)
