"""The record of sessions: all arrays that the tables, the figures and the failure analysis need, and their storage."""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zarr
from jaxtyping import Bool, Float, Int64

from clothkit.dataset.store import LENGTHS, MANIPULATION_UNITS, NORMALISED, SPLITS, STEPS, Dataset, labels_of
from clothkit.dataset.tasks import Task
from clothkit.dataset.zarr_store import Declared, consolidate, create_array, create_group, open_store
from clothkit.episodes.record_checks import KEYS, check_keys, check_members, check_values, terms_of_nets
from clothkit.manipulation.vector import is_null
from clothkit.planning.planner import Planner
from clothkit.planning.types import Plan
from clothkit.runtime.errors import damaged_piece
from clothkit.simulation.cloths import Cloths

MESH_AXES = ("u", "v", "xyz")
STATE_AXES = ("seen_0", "seen_1", "seen_2")
"""Dimensions of a state as the system observes it: a mesh, or voxels."""

STD_AXES = ("std_0", "std_1", "std_2")
"""Dimensions of what only meshes have: of length 0 for a system that plans in voxels, else as `STATE_AXES`."""

_LENGTHS = {**LENGTHS, "planned": STEPS}
_HOLDS = "which a record of sessions holds"

CLOTH_LENGTHS = "cloth length"
"""Unit of errors: the flat cloth's longer side."""

_IN_VOXELS = {
    **dict.fromkeys(("estimate", "prediction_mean", "prediction_std", "refined", "expected"), "1"),
    "plan": NORMALISED,
}
"""Units of what is of another kind where a system plans in voxels."""

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
    cloths: Cloths
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
    centre, cloths = dataset.centre[sequence, start], dataset.cloths(sequence)
    return Tasks(tasks, [split] * len(tasks), states, centre, goal, cloths, recorded)


def _array(dtype: str, *dimensions: str, units: str = "1") -> Any:
    """A field of the record: an array with that dtype and those dimensions, in memory and in the store, and a unit."""
    return dataclasses.field(metadata={"declared": Declared(dtype, dimensions, units)})


@dataclasses.dataclass(frozen=True)
class Sessions:
    """Sessions of one system, a row per task, in normalised units. After a session's end, floats are NaN, labels -1.

    A session of length n has states 0..n and, for each of its n steps, one plan for the remaining steps. Plans and
    predictions are in the labels of that step's estimate; states and goal are in the dataset's labels. If the system
    plans in voxels, estimates and predictions are voxels (occupancy 0..1, without standard deviations) and grasp points
    are Cartesian. The axis `net` has the system's K nets, in the order of its members; `term` is one longer.
    """

    split: np.ndarray = _array("i1", "task")
    sequence: np.ndarray = _array("i8", "task")
    start: np.ndarray = _array("i1", "task")
    length: np.ndarray = _array("i1", "task")
    goal: np.ndarray = _array("f4", "task", *MESH_AXES, units=NORMALISED)
    cloth: np.ndarray = _array("f4", "task", "measure", units=NORMALISED)
    """Sides along u and v and thickness."""
    state: np.ndarray = _array("f4", "task", "state", *MESH_AXES, units=NORMALISED)
    """True states, centred; the last one is the outcome."""
    centre: np.ndarray = _array("f4", "task", "state", "xy", units=NORMALISED)
    estimate: np.ndarray = _array("f4", "task", "step", *STATE_AXES, units=NORMALISED)
    """The initial state of the search, as the system observes it: an estimate, a true mesh or voxels."""
    candidates: np.ndarray = _array("f4", "task", "step", "candidate", "xy", units=NORMALISED)
    """Candidate grasp points on the estimate."""
    plan: np.ndarray = _array("f4", "task", "step", "planned", "component", units=MANIPULATION_UNITS)
    loss: np.ndarray = _array("f4", "task", "step")
    terms: np.ndarray = _array("f4", "task", "step", "term")
    """The accuracy term of each net, then that of uncertainty: u of eq. (15), or what is chosen in its place; 0 if the
    objective has none."""
    common: np.ndarray = _array("i1", "task", "step")
    """Index of the common equivalent in which the plan was found."""
    relative: np.ndarray = _array("i1", "task", "step")
    """Index of the relabelling that brings the goal to the estimate's labels."""
    null: np.ndarray = _array("?", "task", "step")
    """Whether the plan's first manipulation was not executed."""
    cancelled: np.ndarray = _array("?", "task", "step")
    """Whether the null check cancelled it. False for plans whose first manipulation is itself null."""
    error_otherwise: np.ndarray = _array("f4", "task", "step", units=CLOTH_LENGTHS)
    """For cancelled manipulations, the error to the goal if they had been executed [cloth length, aligned]."""
    expected: np.ndarray = _array("f4", "task", "step", units=CLOTH_LENGTHS)
    """Predicted distance between the plan's outcome and the goal, in the measure of the null check."""
    loss_recorded: np.ndarray = _array("f4", "task")
    """Planning loss of the recorded manipulations, starting from the first estimate."""
    offered: np.ndarray = _array("?", "task")
    """Whether each recorded first grasp point is near a candidate of the first step (see `diagnosis.is_offered`)."""
    prediction_mean: np.ndarray = _array("f2", "task", "step", "planned", "net", *STATE_AXES, units=NORMALISED)
    prediction_std: np.ndarray = _array("f2", "task", "step", "planned", "net", *STD_AXES, units=NORMALISED)
    refined: np.ndarray = _array("f2", "task", "step", *STD_AXES, units=NORMALISED)
    """The best net's prediction of the plan's outcome, refined; NaN where sessions were run without it."""
    progress: np.ndarray = _array("f4", "task", "step", "iteration")
    """Lowest loss of all strains up to that iteration, as the optimiser evaluates it: not exact, unlike `loss`."""
    tried: np.ndarray = _array("i4", "task", "step")
    """Number of plans that the search evaluated in an iteration."""

    def __post_init__(self) -> None:
        lengths: dict[str, int] = {}
        for name, field in FIELDS.items():
            shape = getattr(self, name).shape
            found = dict(zip(field.dimensions, shape, strict=True))
            for dimension, length in found.items():
                if lengths.setdefault(dimension, length) != length:
                    raise ValueError(f"{name}: expected {lengths[dimension]} of {dimension}, found {length}")
        if lengths["term"] != lengths["net"] + 1:
            raise ValueError(f"terms: expected one of each of {lengths['net']} nets and u, found {lengths['term']}")

    def __len__(self) -> int:
        return len(self.sequence)


FIELDS: dict[str, Declared] = {field.name: field.metadata["declared"] for field in dataclasses.fields(Sessions)}
"""What each array of the record holds."""


class Sizes(NamedTuple):
    """Lengths of those dimensions that depend on the settings and the system."""

    state: tuple[int, ...]
    """Shape of a state in the system's representation."""
    probabilistic: bool
    """Whether predictions have standard deviations and are refined to meshes."""
    candidate: int
    net: int
    iteration: int


def sizes_of(planner: Planner) -> Sizes:
    """The sizes of the arrays in a record of a planner's sessions."""
    optimiser = planner.settings.search.optimiser
    return Sizes(
        state=planner.representation.shape,
        probabilistic=planner.representation.probabilistic,
        candidate=planner.grasping.most,
        net=len(planner.nets),
        iteration=optimiser.shape(STEPS)[0],
    )


class Step(NamedTuple):
    """One step of a batch's sessions, for the tasks that are not over yet."""

    tasks: Int64[np.ndarray, " acting"]
    """Their rows in the batch."""
    plan: Plan
    refined: Float[np.ndarray, "acting u v 3"] | None
    """The best net's prediction of the outcome, refined to a plausible mesh; None for voxels, and where it is not asked
    for."""
    state: Float[np.ndarray, "acting u v 3"]
    """The true state after the step, centred."""
    centre: Float[np.ndarray, "acting 2"]
    error_otherwise: Float[np.ndarray, " acting"]


def record(tasks: Tasks, steps: Sequence[Step], sizes: Sizes) -> Sessions:
    """The record of a batch's sessions, from their steps in order.

    State 0 is the start state; what comes after the last step is filled with NaN, -1 or False.
    """
    fields = _empty(tasks, sizes)
    for number, step in enumerate(steps):
        plan, at = step.plan, (step.tasks, number)
        fields["state"][step.tasks, number + 1], fields["centre"][step.tasks, number + 1] = step.state, step.centre
        fields["estimate"][at], fields["candidates"][at] = plan.state, plan.candidates
        fields["plan"][at], fields["loss"][at], fields["terms"][at] = plan.manipulations, plan.loss, _terms(plan)
        fields["common"][at], fields["relative"][at] = plan.common, plan.relative
        fields["null"][at], fields["cancelled"][at] = plan.null, plan.useless & ~_first_is_null(plan)
        fields["error_otherwise"][at], fields["expected"][at] = step.error_otherwise, plan.expected
        fields["prediction_mean"][at] = plan.means
        if plan.stds is not None:
            fields["prediction_std"][at] = plan.stds
        if step.refined is not None:
            fields["refined"][at] = step.refined
        fields["progress"][at], fields["tried"][at] = plan.progress, plan.tried
    return Sessions(**fields)


def _first_is_null(plan: Plan) -> Bool[np.ndarray, " acting"]:
    """Whether a plan's first manipulation is itself a null manipulation, apart from the null check."""
    return np.asarray(is_null(plan.manipulations[:, 0]))


def _terms(plan: Plan) -> Float[np.ndarray, "acting term"]:
    """The accuracy term of each net, then u, 0 if it is no term of the objective."""
    accuracy = plan.terms["accuracy"]
    u = plan.terms.get("uncertainty", np.zeros(len(accuracy), np.float32))
    return np.concatenate([accuracy, u[:, None]], axis=1)


def _empty(tasks: Tasks, sizes: Sizes) -> dict[str, np.ndarray]:
    lengths = {"task": len(tasks.task), **_LENGTHS}
    lengths |= {name: getattr(sizes, name) for name in ("candidate", "net", "iteration")}
    lengths["term"] = sizes.net + 1
    lengths |= dict(zip(STATE_AXES, sizes.state, strict=True))
    lengths |= {name: length * sizes.probabilistic for name, length in zip(STD_AXES, sizes.state, strict=True)}
    missing = {"f4": np.nan, "f2": np.nan, "i1": -1, "i4": -1, "?": False}
    empty: dict[str, np.ndarray] = {
        name: np.full([lengths[d] for d in field.dimensions], missing[field.dtype], field.dtype)
        for name, field in FIELDS.items()
        if field.dtype in missing
    }
    empty["split"] = np.array(tasks.split, dtype="U10")
    empty["sequence"] = np.array([task.sequence for task in tasks.task], np.int64)
    empty["start"] = np.array([task.start for task in tasks.task], np.int8)
    empty["length"] = np.array([task.length for task in tasks.task], np.int8)
    empty["goal"] = np.asarray(tasks.goal, np.float32)
    empty["cloth"] = tasks.cloths.cloth
    empty["state"][:, 0] = tasks.start
    empty["centre"][:, 0] = tasks.centre
    return empty


def join(parts: list[Sessions]) -> Sessions:
    """The sessions of several batches, concatenated along the task axis."""
    return Sessions(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in FIELDS})


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
    group = create_group(path, {**attributes, "splits": list(SPLITS), "labels": labels_of(FIELDS)})
    # Arrays are kept, because one that is opened anew would leave out chunks of zeros.
    arrays: dict[str, zarr.Array] = {}
    for block in _blocks(parts, SHARD):
        for name, field in FIELDS.items():
            values = getattr(block, name)
            if name == "split":
                values = np.array([SPLITS.index(value) for value in values], np.int8)
            if name in arrays:
                arrays[name].append(values)
                continue
            chunk = tuple(max(1, length) for length in values.shape[1:])
            if not block.prediction_std.size:
                field = field._replace(units=_IN_VOXELS.get(name, field.units))
            arrays[name] = create_array(group, name, field, values, chunk=(1, *chunk), shard=(SHARD, *chunk))
    consolidate(group)


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
    return Sessions(**{name: getattr(sessions, name)[chosen].copy() for name in FIELDS})


def load(path: Path, chosen: slice = slice(None)) -> Sessions:
    """Read sessions from a zarr store: all of them, or the slice `chosen`.

    Stores of a single net that were made before nets had any number have an empty term between the others; it is left
    out. Raises InputError for a store that is missing, damaged or not as declared, and for inconsistent sessions.
    """
    store = open_store(path, FIELDS, lengths=_LENGTHS, holds=_HOLDS)
    arrays = {name: store.read(name, chosen) for name in FIELDS}
    arrays["terms"] = terms_of_nets(path, arrays["terms"], arrays["prediction_mean"].shape[3])
    names = check_keys(path, arrays, store.attributes)
    check_values(path, arrays)
    return Sessions(**{**arrays, "split": np.array(names, dtype="U10")[arrays["split"]]})


def load_tasks(path: Path) -> list[tuple[str, int, int, int]]:
    """Read the split, sequence, start and length of each recorded session. Raises InputError, as `load` does."""
    store = open_store(path, {name: FIELDS[name] for name in KEYS}, lengths=_LENGTHS, holds=_HOLDS)
    arrays = {name: store.read(name) for name in KEYS}
    names = check_keys(path, arrays, store.attributes)
    splits = [names[code] for code in arrays["split"]]
    return list(zip(splits, *(arrays[name].tolist() for name in KEYS[1:]), strict=True))


def load_members(path: Path) -> tuple[int, ...]:
    """Read which members of the ensemble the nets of the recorded sessions are, in the order of the axis `net`.

    Stores made before ensembles had members do not say it: their nets are counted from 0. Raises InputError, as `load`
    does, and for members that are not one number for each net.
    """
    store = open_store(path, {"prediction_mean": FIELDS["prediction_mean"]}, lengths=_LENGTHS, holds=_HOLDS)
    return check_members(path, store.attributes, store.shape("prediction_mean")[3])
