"""Named goals that were made are kept, by what they depend on: cloth, simulator and the code of both."""

import functools
import hashlib
import os
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, as_completed
from pathlib import Path
from typing import TypeVar

from tqdm import tqdm

import clothkit
from clothkit.cloth.topology import Topology
from clothkit.goals.making import Made, careful, make
from clothkit.manipulation.named_folds import GOALS, Goal
from clothkit.runtime.cache import writable
from clothkit.runtime.errors import InputError
from clothkit.runtime.publish import unfinished
from clothkit.runtime.resumable import array_storage, load_piece
from clothkit.simulation.processes import Kind, cores, open_pool
from clothkit.simulation.settings import SimulationConfig

T = TypeVar("T")
Wanted = tuple[str, Topology, SimulationConfig]
"""A goal's name, and the cloth and the world that it is made of."""

WORK = Path(".work/goals")
"""Where stages keep goals."""

CODE = ("cloth", "goals/making.py", "manipulation", "simulation")
"""The code that decides what a goal looks like."""

STORAGE = array_storage(Made)


def user_folder() -> Path:
    """Where commands keep goals: in the user's cache, or if that can't be written, in a folder for this run."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "clothkit/goals"
    return writable(home, "named goals") or home


def named(name: str) -> Goal:
    """The goal of that name. Raises InputError if there is none."""
    if name not in GOALS:
        raise InputError(f"goal: expected one of {', '.join(GOALS)}, found {name!r}")
    return GOALS[name]


def made(name: str, topology: Topology, simulation: SimulationConfig, *, folder: Path) -> Made:
    """A goal of a cloth, from `folder` or else made and kept there.

    Raises InputError for a name that is not known, a goal that can't be made, or a file in `folder` that is damaged.
    """
    goal = named(name)
    path = folder / f"{key(goal, topology, simulation)}{STORAGE.suffix}"
    if path.exists():
        return load_piece(path, STORAGE)
    found = make(goal, topology, simulation)
    _keep(found, path)
    return found


def made_all(
    wanted: Sequence[Wanted],
    *,
    folder: Path,
    workers: int = 0,
    executor: Kind = "processes",
    scheduler: str = "",
) -> list[Made | InputError]:
    """Several goals of several cloths, made on `workers` processes (0: all cores) or by a cluster, in order.

    `executor` and `scheduler` are as in `open_pool`. Goals are stored by this process, as they come. In place of a goal
    that can't be made there is the error that says why. Raises InputError for unknown names, and for a cluster that
    can't be reached or is lost.
    """
    paths = {one: folder / f"{key(named(one[0]), *one[1:])}{STORAGE.suffix}" for one in wanted}
    missing = [one for one, path in paths.items() if not path.exists()]
    count = min(workers or cores(), len(missing))
    failed: dict[Wanted, InputError] = {}

    def take(one: Wanted, found: Made | InputError) -> None:
        if isinstance(found, InputError):
            failed[one] = found
        else:
            _keep(found, paths[one])

    if missing and (executor == "dask" or count > 1):
        with open_pool(executor, workers=count, scheduler=scheduler) as pool:
            jobs: dict[Future[Made | InputError], Wanted] = {pool.submit(_tried, *one): one for one in missing}
            for job in _bar(as_completed(jobs), len(jobs)):
                take(jobs[job], job.result())
    else:
        for one in _bar(missing, len(missing)):
            take(one, _tried(*one))
    return [failed.get(one) or made(*one, folder=folder) for one in wanted]


def _keep(found: Made, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with unfinished(path) as part:
        STORAGE.save(part, found)


def _tried(name: str, topology: Topology, simulation: SimulationConfig) -> Made | InputError:
    """A goal, or the error if it can't be made."""
    try:
        return make(named(name), topology, simulation)
    except InputError as error:
        return error


def _bar(items: Iterable[T], count: int) -> Iterable[T]:
    found: Iterable[T] = tqdm(items, desc="goals", unit="goal", total=count, disable=not count)
    return found


def key(goal: Goal, topology: Topology, simulation: SimulationConfig) -> str:
    """The name under which a goal is kept: the same for all that makes no difference to it."""
    what = repr((goal.name, topology, careful(simulation)))
    return f"{goal.name}_{hashlib.sha256(what.encode() + _code()).hexdigest()[:20]}"


@functools.cache
def _code() -> bytes:
    """A digest of the code that makes goals."""
    root, digest = Path(clothkit.__file__).parent, hashlib.sha256()
    for place in CODE:
        path = root / place
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(file.read_bytes())
    return digest.digest()
