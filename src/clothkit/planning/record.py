"""What a session leaves: everything that tables, figures and failure analysis ask for, as plain arrays."""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zarr
from jaxtyping import Bool, Float, Float16, Int8, Int64

from clothkit.dataset.store import LENGTHS, SPLITS, STEPS, Dataset
from clothkit.dataset.tasks import Task
from clothkit.dataset.zarr_store import Declared, open_store, written
from clothkit.errors import damaged_piece
from clothkit.planning.record_checks import KEYS, check_counts, check_keys, check_values

MESH = ("u", "v", "xyz")
SEEN = ("seen_0", "seen_1", "seen_2")
SURE = ("std_0", "std_1", "std_2")
_LENGTHS = {**LENGTHS, "planned": STEPS, "term": 3}
_HOLDS = "which a record of sessions holds"

SHARD = 120
"""Tasks that are written together, and that share a file of each array: what bounds the memory, and the files."""


class Stretch(NamedTuple):
    """A recorded way to a goal."""

    states: Float[np.ndarray, "state u v 3"]
    """True states from start to goal, centred."""
    manipulations: Float[np.ndarray, "n 6"]


class Tasks(NamedTuple):
    """A batch of tasks with what is given: where the cloth starts and what it shall become."""

    task: list[Task]
    split: list[str]
    start: Float[np.ndarray, "task u v 3"]
    """True start, centred."""
    centre: Float[np.ndarray, "task 2"]
    """Its centre."""
    goal: Float[np.ndarray, "task u v 3"]
    """True goal, centred."""
    recorded: list[Stretch] | None = None
    """How the goals were reached when they were recorded, to hold what is found against: no planner sees it."""


def tasks_of_dataset(dataset: Dataset, tasks: list[Task], split: str) -> Tasks:
    """The given tasks of a dataset, all of one split; `sequence` indexes the dataset."""
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
    """Sessions of one system, a row per task; normalised units. Past a session's end floats are NaN, labels -1.

    A session of length n has states 0..n and, for each step before its end, one plan for the steps that are left. Plans
    and predictions are in the labels of that step's estimate; states and goal are in the dataset's. A system that
    plans in voxels estimates and predicts voxels (occupancy 0..1, without standard deviations), and its grasp points
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
    """What was planned from."""
    candidates: Float[np.ndarray, "task step candidate 2"]
    """Grasp points on the estimate."""
    plan: Float[np.ndarray, "task step planned 6"]
    loss: Float[np.ndarray, "task step"]
    terms: Float[np.ndarray, "task step term"]
    """Accuracy terms of nets a and b, u."""
    common: Int8[np.ndarray, "task step"]
    """The common equivalent in which the plan was found."""
    relative: Int8[np.ndarray, "task step"]
    """The relabelling that brings the goal under the estimate's labels."""
    null: Bool[np.ndarray, "task step"]
    """Whether the plan's first manipulation was not executed."""
    cancelled: Bool[np.ndarray, "task step"]
    """Whether that was the null check's doing, and not because the manipulation was too short to be one."""
    error_otherwise: Float[np.ndarray, "task step"]
    """Where it was: the error to the goal had the manipulation been executed [cloth length, aligned]."""
    expected: Float[np.ndarray, "task step"]
    """How far from the goal the nets expect the plan to end, in the measure of the null check."""
    loss_recorded: Float[np.ndarray, " task"]
    """The planning loss of the recorded manipulations, from the first estimate."""
    offered: Bool[np.ndarray, " task"]
    """Whether the recorded first grasp points were among the first candidates, nearly."""
    prediction_mean: Float16[np.ndarray, "task step planned net *seen"]
    prediction_std: Float16[np.ndarray, "task step planned net *sure"]
    refined: Float16[np.ndarray, "task step *mesh"]
    """The better net's prediction of the plan's outcome, refined."""
    progress: Float[np.ndarray, "task step iteration"]
    """Lowest loss of any strain so far."""
    restarts: Float[np.ndarray, "task step strain restart"]
    """Lowest loss of each strain between restarts."""

    def __len__(self) -> int:
        return len(self.sequence)


class Sizes(NamedTuple):
    """Lengths of the dimensions that settings and system decide."""

    state: tuple[int, ...]
    """*state: of what is seen."""
    probabilistic: bool
    """Whether predictions have standard deviations, and refined meshes."""
    candidate: int
    net: int
    iteration: int
    strain: int
    restart: int


def blank(tasks: Tasks, sizes: Sizes) -> Sessions:
    """Sessions that have not begun: state 0 is the start."""
    lengths = {"task": len(tasks.task), **_LENGTHS}
    lengths |= {name: getattr(sizes, name) for name in ("candidate", "net", "iteration", "strain", "restart")}
    lengths |= dict(zip(SEEN, sizes.state, strict=True))
    # What voxels do not have is empty.
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
    "split": Declared("i1", ("task",), zeros=True),
    "sequence": Declared("i8", ("task",), zeros=True),
    "start": Declared("i1", ("task",), zeros=True),
    "length": Declared("i1", ("task",)),
    "goal": Declared("f4", ("task", *MESH)),
    "state": Declared("f4", ("task", "state", *MESH)),
    "centre": Declared("f4", ("task", "state", "xy"), zeros=True),
    "estimate": Declared("f4", ("task", "step", *SEEN)),
    "candidates": Declared("f4", ("task", "step", "candidate", "xy")),
    "plan": Declared("f4", ("task", "step", "planned", "component")),
    "loss": Declared("f4", ("task", "step")),
    "terms": Declared("f4", ("task", "step", "term")),
    "common": Declared("i1", ("task", "step"), zeros=True),
    "relative": Declared("i1", ("task", "step"), zeros=True),
    "null": Declared("?", ("task", "step"), zeros=True),
    "cancelled": Declared("?", ("task", "step"), zeros=True),
    "error_otherwise": Declared("f4", ("task", "step")),
    "expected": Declared("f4", ("task", "step")),
    "loss_recorded": Declared("f4", ("task",)),
    "offered": Declared("?", ("task",), zeros=True),
    "prediction_mean": Declared("f2", ("task", "step", "planned", "net", *SEEN)),
    "prediction_std": Declared("f2", ("task", "step", "planned", "net", *SURE)),
    "refined": Declared("f2", ("task", "step", *SURE)),
    "progress": Declared("f4", ("task", "step", "iteration")),
    "restarts": Declared("f4", ("task", "step", "strain", "restart")),
}


def join(parts: list[Sessions]) -> Sessions:
    """Sessions of several batches, one after the other."""
    return Sessions(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in _FIELDS})


def save_piece(path: Path, sessions: Sessions) -> None:
    """Keep a batch's sessions in a work directory; the file appears whole or not at all."""
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
    """Sessions of many batches, one after the other, read from their files when they are asked for."""

    paths: Sequence[Path]

    def __iter__(self) -> Iterator[Sessions]:
        return map(load_piece, self.paths)

    def whole(self) -> Sessions:
        """All of them."""
        return join(list(self))


def save(path: Path, parts: Iterable[Sessions], attributes: dict[str, Any]) -> None:
    """Write the sessions of batches, one after the other, as a zarr v3 group: a chunk per task, SHARD tasks a shard."""
    # Zarr has no stable type for strings: the names go to the attributes.
    group = zarr.open_group(path, mode="w", zarr_format=3, attributes={**attributes, "splits": list(SPLITS)})
    for block in _blocks(parts, SHARD):
        for name, field in _FIELDS.items():
            values = getattr(block, name)
            if name == "split":
                values = np.array([SPLITS.index(value) for value in values], np.int8)
            if name in group:
                group[name].append(values)  # type: ignore[union-attr]
                continue
            chunk = tuple(max(1, length) for length in values.shape[1:])
            shards = (SHARD, *chunk)
            group.create_array(
                name,
                data=values,
                chunks=(1, *chunk),
                shards=shards,
                dimension_names=field.dimensions,
                config=written(field),
            )


def _blocks(parts: Iterable[Sessions], size: int) -> Iterator[Sessions]:
    """The same sessions in blocks of `size` tasks, the last of what is left."""
    held: Sessions | None = None
    for part in parts:
        held = part if held is None else join([held, part])
        while len(held) >= size:
            yield _cut(held, slice(size))
            held = _cut(held, slice(size, None))
    if held is not None and len(held):
        yield held


def _cut(sessions: Sessions, chosen: slice) -> Sessions:
    # Copied, so that nothing holds on to the rest.
    return Sessions(**{name: getattr(sessions, name)[chosen].copy() for name in _FIELDS})


def load(path: Path, chosen: slice = slice(None)) -> Sessions:
    """Read sessions back, all or a stretch of them.

    Raises InputError for a store that is missing, damaged or not as declared, and for sessions that can't be.
    """
    store = open_store(path, _FIELDS, lengths=_LENGTHS, holds=_HOLDS)
    arrays = {name: store.read(name, chosen) for name in _FIELDS}
    names = check_keys(path, arrays, store.attributes)
    if chosen == slice(None):
        check_counts(path, arrays, store.attributes)
    check_values(path, arrays)
    return Sessions(**{**arrays, "split": np.array(names, dtype="U10")[arrays["split"]]})


def load_tasks(path: Path) -> list[tuple[str, int, int, int]]:
    """Split, sequence, start and length of each recorded session. Raises InputError, as `load` does."""
    store = open_store(path, {name: _FIELDS[name] for name in KEYS}, lengths=_LENGTHS, holds=_HOLDS)
    arrays = {name: store.read(name) for name in KEYS}
    names = check_keys(path, arrays, store.attributes)
    check_counts(path, arrays, store.attributes)
    splits = [names[code] for code in arrays["split"]]
    return list(zip(splits, *(arrays[name].tolist() for name in KEYS[1:]), strict=True))
