"""Named goals that were made are kept, by what they depend on: cloth, simulator and the code of both."""

import functools
import hashlib
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeVar

from tqdm import tqdm

import clothkit
from clothkit.cloth.topology import Topology
from clothkit.goals.folds import GOALS, Goal
from clothkit.goals.making import Made, careful, make
from clothkit.runtime.cache import writable
from clothkit.runtime.errors import InputError
from clothkit.runtime.publish import unfinished
from clothkit.runtime.resumable import array_storage, load_piece
from clothkit.simulation.processes import cores, make_pool
from clothkit.simulation.settings import SimulationConfig

T = TypeVar("T")

WORK = Path(".work/goals")
"""Where stages keep goals."""

CODE = ("cloth", "goals/folds.py", "goals/making.py", "manipulation", "simulation")
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
    folder.mkdir(parents=True, exist_ok=True)
    with unfinished(path) as part:
        STORAGE.save(part, found)
    return found


def made_all(
    wanted: Sequence[tuple[str, Topology, SimulationConfig]], *, folder: Path, workers: int = 0
) -> list[Made | InputError]:
    """Several goals of several cloths, made on `workers` processes (0: all cores), in order.

    In place of a goal that can't be made there is the error that says why. Raises InputError for unknown names.
    """
    missing = [one for one in wanted if not (folder / f"{key(named(one[0]), *one[1:])}{STORAGE.suffix}").exists()]
    count = min(workers or cores(), len(missing))
    if count > 1:
        with make_pool(count) as pool:
            jobs = [pool.submit(_tried, *one, folder) for one in missing]
            failed = {one: job.result() for one, job in zip(missing, _bar(jobs), strict=True)}
    else:
        failed = {one: _tried(*one, folder) for one in _bar(missing)}
    return [failed.get(one) or made(*one, folder=folder) for one in wanted]


def _tried(name: str, topology: Topology, simulation: SimulationConfig, folder: Path) -> InputError | None:
    """Make and keep a goal; the error if it can't be made."""
    try:
        made(name, topology, simulation, folder=folder)
    except InputError as error:
        return error
    return None


def _bar(items: list[T]) -> Iterable[T]:
    found: Iterable[T] = tqdm(items, desc="goals", unit="goal", disable=not items)
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
