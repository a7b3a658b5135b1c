"""The record of sessions: all arrays that the tables, the figures and the failure analysis need, and their storage."""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zarr
from jaxtyping import Bool, Float, Float16, Int8, Int64

from clothkit.dataset.store import LENGTHS, SPLITS, STEPS, Dataset
from clothkit.dataset.tasks import Task
from clothkit.dataset.zarr_store import WRITTEN, Declared, open_store
from clothkit.errors import damaged_piece
from clothkit.planning.record_checks import KEYS, check_keys, check_values

MESH = ("u", "v", "xyz")
SEEN = ("seen_0", "seen_1", "seen_2")
SURE = ("std_0", "std_1", "std_2")
_LENGTHS = {**LENGTHS, "planned": STEPS, "term": 3}
_HOLDS = "which a record of sessions holds"

SHARD = 120
"""Tasks per shard file of each array: they are written together, which limits memory and the number of files."""


class Stretch(NamedTuple):
    """A recorded subsequence, which ends at a task's goal."""

    states: Float[np.ndarray, "state u v 3"]
    """True states from start to goal, centred."""
    manipulations: Float[np.ndarray, "n 6"]


class Tasks(NamedTuple):
    """A batch of tasks with their start and goal states."""

    task: list[Task]
    split: list[str]
    start: Float[np.ndarray, "task u v 3"]
    """True start state, centred."""
    centre: Float[np.ndarray, "task 2"]
    """Centre of the start state on the table."""
    goal: Float[np.ndarray, "task u v 3"]
    """True goal state, centred."""
    recorded: list[Stretch] | None = None
    """The recorded subsequences from start to goal, for diagnosis only: planners never use them."""


def tasks_of_dataset(dataset: Dataset, tasks: list[Task], split: str) -> Tasks:
    """The start and goal states of tasks of a dataset, all of one split; a task's `sequence` is an index into it."""
    sequence, start, length = np.array(tasks).T
    recorded = [
        Stretch(dataset.vertices[s, i : i + n + 1], dataset.manipulation[s, i : i + n])
        for s, i, n in zip(sequence, start, length, strict=True)
    ]
    states = dataset.vertices[sequence, start]
    goal = dataset.vertices[sequence, start + length]
    return Tasks(tasks, [split] * len(tasks), states, dataset.centre[sequence, start], goal, recorded)


@dataclasses.dataclass(frozen=True)
class Sessions:
    """Sessions of one system, a row per task, in normalised units. After a session's end, floats are NaN, labels -1.

    A session of length n has states 0..n and, for each of its n steps, one plan for the remaining steps. Plans and
    predictions are in the labels of that step's estimate; states and goal are in the dataset's labels. If the system
    plans in voxels, estimates and predictions are voxels (occupancy 0..1, without standard deviations) and grasp points
    are Cartesian.
    """

    split: np.ndarray
    sequence: Int64[np.ndarray, " task"]
    start: Int8[np.ndarray, " task"]
    length: Int8[np.ndarray, " task"]
    goal: Float[np.ndarray, "task u v 3"]
    state: Float[np.ndarray, "task state u v 3"]
    """True states, centred; the last one is the outcome."""
    centre: Float[np.ndarray, "task state 2"]
    estimate: Float[np.ndarray, "task step *seen"]
    """The initial state of the search, as the system observes it: an estimate, a true mesh or voxels."""
    candidates: Float[np.ndarray, "task step candidate 2"]
    """Candidate grasp points on the estimate."""
    plan: Float[np.ndarray, "task step planned 6"]
    loss: Float[np.ndarray, "task step"]
    terms: Float[np.ndarray, "task step term"]
    """Accuracy terms of nets a and b, then u."""
    common: Int8[np.ndarray, "task step"]
    """Index of the common equivalent in which the plan was found."""
    relative: Int8[np.ndarray, "task step"]
    """Index of the relabelling that brings the goal to the estimate's labels."""
    null: Bool[np.ndarray, "task step"]
    """Whether the plan's first manipulation was not executed."""
    cancelled: Bool[np.ndarray, "task step"]
    """Whether the null check cancelled it. False for plans whose first manipulation is itself null."""
    error_otherwise: Float[np.ndarray, "task step"]
    """For cancelled manipulations, the error to the goal if they had been executed [cloth length, aligned]."""
    expected: Float[np.ndarray, "task step"]
    """Predicted distance between the plan's outcome and the goal, in the measure of the null check."""
    loss_recorded: Float[np.ndarray, " task"]
    """Planning loss of the recorded manipulations, starting from the first estimate."""
    offered: Bool[np.ndarray, " task"]
    """Whether each recorded first grasp point is near a candidate of the first step (see `diagnosis.offered`)."""
    prediction_mean: Float16[np.ndarray, "task step planned net *seen"]
    prediction_std: Float16[np.ndarray, "task step planned net *sure"]
    refined: Float16[np.ndarray, "task step *mesh"]
    """The better net's prediction of the plan's outcome, refined."""
    progress: Float[np.ndarray, "task step iteration"]
    """Lowest loss of all strains up to that iteration."""
    restarts: Float[np.ndarray, "task step strain restart"]
    """Lowest loss of each strain between restarts."""

    def __len__(self) -> int:
        return len(self.sequence)


class Sizes(NamedTuple):
    """Lengths of those dimensions that depend on the settings and the system."""

    state: tuple[int, ...]
    """Shape of a state in the system's representation."""
    probabilistic: bool
    """Whether predictions have standard deviations and are refined to meshes."""
    candidate: int
    net: int
    iteration: int
    strain: int
    restart: int


def blank(tasks: Tasks, sizes: Sizes) -> Sessions:
    """Records of sessions that have not started.

    State 0 is the start state; everything later is filled with NaN, -1 or False.
    """
    lengths = {"task": len(tasks.task), **_LENGTHS}
    lengths |= {name: getattr(sizes, name) for name in ("candidate", "net", "iteration", "strain", "restart")}
    lengths |= dict(zip(SEEN, sizes.state, strict=True))
    # Voxels have no standard deviations and no refined meshes: these arrays get dimensions of length 0.
    lengths |= {name: length * sizes.probabilistic for name, length in zip(SURE, sizes.state, strict=True)}
    kinds = {"f4": np.nan, "f2": np.nan, "i1": -1, "?": False}
    empty: dict[str, np.ndarray] = {
        name: np.full([lengths[d] for d in field.dimensions], kinds[field.dtype], field.dtype)
        for name, field in _FIELDS.items()
        if field.dtype in kinds
    }
    empty["split"] = np.array(tasks.split, dtype="U10")
    empty["sequence"] = np.array([task.sequence for task in tasks.task], np.int64)
    empty["start"] = np.array([task.start for task in tasks.task], np.int8)
    empty["length"] = np.array([task.length for task in tasks.task], np.int8)
    empty["goal"] = np.asarray(tasks.goal, np.float32)
    empty["state"][:, 0] = tasks.start
    empty["centre"][:, 0] = tasks.centre
    return Sessions(**empty)


_FIELDS: dict[str, Declared] = {
    "split": Declared("i1", ("task",)),
    "sequence": Declared("i8", ("task",)),
    "start": Declared("i1", ("task",)),
    "length": Declared("i1", ("task",)),
    "goal": Declared("f4", ("task", *MESH)),
    "state": Declared("f4", ("task", "state", *MESH)),
    "centre": Declared("f4", ("task", "state", "xy")),
    "estimate": Declared("f4", ("task", "step", *SEEN)),
    "candidates": Declared("f4", ("task", "step", "candidate", "xy")),
    "plan": Declared("f4", ("task", "step", "planned", "component")),
    "loss": Declared("f4", ("task", "step")),
    "terms": Declared("f4", ("task", "step", "term")),
    "common": Declared("i1", ("task", "step")),
    "relative": Declared("i1", ("task", "step")),
    "null": Declared("?", ("task", "step")),
    "cancelled": Declared("?", ("task", "step")),
    "error_otherwise": Declared("f4", ("task", "step")),
    "expected": Declared("f4", ("task", "step")),
    "loss_recorded": Declared("f4", ("task",)),
    "offered": Declared("?", ("task",)),
    "prediction_mean": Declared("f2", ("task", "step", "planned", "net", *SEEN)),
    "prediction_std": Declared("f2", ("task", "step", "planned", "net", *SURE)),
    "refined": Declared("f2", ("task", "step", *SURE)),
    "progress": Declared("f4", ("task", "step", "iteration")),
    "restarts": Declared("f4", ("task", "step", "strain", "restart")),
}


def join(parts: list[Sessions]) -> Sessions:
    """The sessions of several batches, concatenated along the task axis."""
    return Sessions(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in _FIELDS})


def save_piece(path: Path, sessions: Sessions) -> None:
    """Write a batch's sessions to a file in a work directory. The file is replaced atomically."""
    unfinished = path.with_suffix(".part.npz")
    np.savez(unfinished, **dataclasses.asdict(sessions))
    unfinished.replace(path)


def load_piece(path: Path) -> Sessions:
    """A batch's sessions from a work directory. Raises InputError when they are damaged."""
    try:
        with path.open("rb") as file, np.load(file) as stored:
            return Sessions(**stored)
    except Exception as error:  # of zipfile, zlib, NumPy
        raise damaged_piece(error, path) from error


@dataclasses.dataclass(frozen=True)
class Pieces:
    """Sessions of many batches in order, each read from its file only when it is iterated over."""

    paths: Sequence[Path]

    def __iter__(self) -> Iterator[Sessions]:
        return map(load_piece, self.paths)

    def whole(self) -> Sessions:
        """All sessions as one record."""
        return join(list(self))


def save(path: Path, parts: Iterable[Sessions], attributes: dict[str, Any]) -> None:
    """Write the sessions of several batches as one zarr v3 group, with one task per chunk and SHARD tasks per shard."""
    # Zarr has no stable type for strings, so the names of the splits are stored as an attribute.
    group = zarr.open_group(path, mode="w", zarr_format=3, attributes={**attributes, "splits": list(SPLITS)})
    # Arrays are kept, because one that is opened anew would leave out chunks of zeros.
    arrays: dict[str, zarr.Array] = {}
    for block in _blocks(parts, SHARD):
        for name, field in _FIELDS.items():
            values = getattr(block, name)
            if name == "split":
                values = np.array([SPLITS.index(value) for value in values], np.int8)
            if name in arrays:
                arrays[name].append(values)
                continue
            chunk = tuple(max(1, length) for length in values.shape[1:])
            shards = (SHARD, *chunk)
            arrays[name] = group.create_array(
                name,
                data=values,
                chunks=(1, *chunk),
                shards=shards,
                dimension_names=field.dimensions,
                **WRITTEN,
            )


def _blocks(parts: Iterable[Sessions], size: int) -> Iterator[Sessions]:
    """The same sessions in blocks of `size` tasks; the last block has the remaining ones."""
    held: Sessions | None = None
    for part in parts:
        held = part if held is None else join([held, part])
        while len(held) >= size:
            yield _cut(held, slice(size))
            held = _cut(held, slice(size, None))
    if held is not None and len(held):
        yield held


def _cut(sessions: Sessions, chosen: slice) -> Sessions:
    # A slice without a copy would keep the memory of the whole record alive.
    return Sessions(**{name: getattr(sessions, name)[chosen].copy() for name in _FIELDS})


def load(path: Path, chosen: slice = slice(None)) -> Sessions:
    """Read sessions from a zarr store: all of them, or the slice `chosen`.

    Raises InputError for a store that is missing, damaged or not as declared, and for inconsistent sessions.
    """
    store = open_store(path, _FIELDS, lengths=_LENGTHS, holds=_HOLDS)
    arrays = {name: store.read(name, chosen) for name in _FIELDS}
    names = check_keys(path, arrays, store.attributes)
    check_values(path, arrays)
    return Sessions(**{**arrays, "split": np.array(names, dtype="U10")[arrays["split"]]})


def load_tasks(path: Path) -> list[tuple[str, int, int, int]]:
    """Read the split, sequence, start and length of each recorded session. Raises InputError, as `load` does."""
    store = open_store(path, {name: _FIELDS[name] for name in KEYS}, lengths=_LENGTHS, holds=_HOLDS)
    arrays = {name: store.read(name) for name in KEYS}
    names = check_keys(path, arrays, store.attributes)
    splits = [names[code] for code in arrays["split"]]
    return list(zip(splits, *(arrays[name].tolist() for name in KEYS[1:]), strict=True))
