"""Resumable work: a map over pieces, each stored once it is computed, so that a killed run goes on with the others."""

import math
import os
import shutil
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from tqdm import tqdm

from clothkit.runtime.errors import InputError, damaged_piece

K = TypeVar("K")
T = TypeVar("T")
Arrays = TypeVar("Arrays", bound=NamedTuple)


@dataclass(frozen=True)
class Storage(Generic[T]):
    """How a piece is stored, as a file or as a folder."""

    save: Callable[[Path, T], None]
    """Writes a piece to a path that does not exist."""
    load: Callable[[Path], T]
    """Reads it back. Any exception means that the piece is damaged."""
    suffix: str = ""
    """Suffix of the names of the pieces' files."""


class Piece(NamedTuple, Generic[T]):
    """A finished piece."""

    path: Path
    value: T
    """As read back from `path`, so that it is the same in the run that computed it and in one that resumes."""


def resumable_map(
    compute: Callable[[K], T],
    keys: Iterable[K],
    *,
    folder: Path,
    name: str,
    storage: Storage[T],
    bar: tqdm,
    count: Callable[[T], int],
    pool: Executor | None = None,
    ahead: Callable[[], int] = lambda: 1,
) -> Iterator[Piece[T]]:
    """Yield the piece of each key in order; a piece that an earlier run has stored in `folder` is not computed again.

    Pieces are stored as `<folder>/<name>_<number><storage.suffix>`, numbered in the order of `keys`, which may be
    endless. A piece gets that name only when it is complete, so a kill at any moment leaves whole pieces. The iterator
    holds one piece at a time; to go over them again in little memory, use `load_piece` with their paths.

    `bar` advances by `count` of each piece, up to its total. With a `pool`, pieces are computed in it in parallel, on
    this machine or another, and stored by this process as they arrive; `ahead` returns how many of those not yet
    yielded may be started, and counts as one if it is less. Raises InputError when a stored piece is damaged.
    """
    folder.mkdir(parents=True, exist_ok=True)
    tasks = ((folder / f"{name}_{number:06d}{storage.suffix}", key) for number, key in enumerate(keys))
    paths: Iterator[Path]
    if pool is None:
        paths = (_finish(compute, key, path, storage) for path, key in tasks)
    else:
        paths = _finished_in_pool(compute, tasks, storage, pool, ahead)
    for path in paths:
        value = load_piece(path, storage)
        bar.update(min(count(value), math.inf if bar.total is None else bar.total - bar.n))
        yield Piece(path, value)


def load_piece(path: Path, storage: Storage[T]) -> T:
    """Read a stored piece. Raises InputError, which names the piece's file or folder, when it is damaged."""
    try:
        return storage.load(path)
    except Exception as error:  # of zipfile, zlib, NumPy, PyArrow, json
        # A loader's own sentence names one file of a folder; what has to be deleted is the piece.
        reason = error.__cause__ if isinstance(error, InputError) and isinstance(error.__cause__, Exception) else error
        raise damaged_piece(reason, path) from error


def array_storage(kind: type[Arrays]) -> Storage[Arrays]:
    """Storage of named tuples of arrays as .npz files."""
    return Storage(_save_arrays, _ArrayLoader(kind), suffix=".npz")


def _save_arrays(path: Path, arrays: NamedTuple) -> None:
    # np.savez adds a suffix to a path, but not to an open file.
    with path.open("wb") as file:
        np.savez(file, **arrays._asdict())


@dataclass(frozen=True)
class _ArrayLoader(Generic[Arrays]):
    kind: type[Arrays]

    def __call__(self, path: Path) -> Arrays:
        with path.open("rb") as file, np.load(file) as arrays:
            return self.kind(*(arrays[name] for name in self.kind._fields))


def _finish(compute: Callable[[K], T], key: K, path: Path, storage: Storage[T]) -> Path:
    """Compute and store the piece of a key unless it is stored already. Returns its path."""
    if not path.exists():
        _store(compute(key), path, storage)
    return path


def _store(value: T, path: Path, storage: Storage[T]) -> None:
    unfinished = path.with_name(f"{path.name}.part")
    if unfinished.is_dir():
        shutil.rmtree(unfinished)
    unfinished.unlink(missing_ok=True)
    storage.save(unfinished, value)
    os.replace(unfinished, path)


def _finished_in_pool(
    compute: Callable[[K], T],
    tasks: Iterator[tuple[Path, K]],
    storage: Storage[T],
    pool: Executor,
    ahead: Callable[[], int],
) -> Iterator[Path]:
    """Yield the paths of the finished pieces in order, and store each as soon as it is computed."""
    started: deque[Path] = deque()
    computing: dict[Future[T], Path] = {}
    while True:
        for path, key in islice(tasks, max(1 - len(started), ahead() - len(started), 0)):
            started.append(path)
            if not path.exists():
                computing[pool.submit(compute, key)] = path
        if not started:
            return
        while started[0] in computing.values():
            done, _ = wait(computing, return_when=FIRST_COMPLETED)
            # A failure is raised only once all that has arrived with it is stored.
            for future in sorted(done, key=lambda future: future.exception() is not None):
                _store(future.result(), computing.pop(future), storage)
        yield started.popleft()
