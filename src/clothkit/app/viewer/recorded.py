"""Read sessions that the pipeline has recorded (episodes.record), one at a time."""

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from clothkit.app.viewer.session import Session, ShownPlan, StateEstimate, Step, is_mesh, matched
from clothkit.cloth.mesh import distance_aligned
from clothkit.cloth.symmetry import relabel
from clothkit.dataset import tables
from clothkit.dataset.zarr_store import open_store
from clothkit.episodes import record
from clothkit.evaluation import tidy
from clothkit.manipulation.vector import is_null
from clothkit.planning.systems import SYSTEMS
from clothkit.planning.uncertainty_terms import MEASURES, Measure

_KEYS = ("sequence", "start", "length")


class Entry(NamedTuple):
    """An entry of a list of recorded sessions."""

    place: int
    """Its row in the record."""
    split: str
    sequence: int
    start: int
    length: int
    error: float | None
    """Error of its outcome [cloth length]; None if there is no table of errors beside the record."""

    @property
    def title(self) -> str:
        """The session's sequence and states in words."""
        return f"sequence {self.sequence}, state {self.start} to {self.start + self.length}"

    @property
    def label(self) -> str:
        """Title and, if known, error."""
        return self.title if self.error is None else f"{self.title} · error {self.error:.3f}"


def systems_in(data: Path) -> list[str]:
    """The systems whose sessions are recorded under `data`."""
    return [name for name in SYSTEMS if os.path.lexists(_store(data, name))]


def _store(data: Path, system: str) -> Path:
    return data / f"evaluation/planning/sessions_{system}.zarr"


def entries(data: Path, system: str) -> list[Entry]:
    """The recorded sessions of a system, in the record's order. Raises InputError."""
    errors = _errors(data / f"evaluation/planning/{system}.parquet")
    tasks = record.load_tasks(_store(data, system))
    return [Entry(place, *task, errors.get(task)) for place, task in enumerate(tasks)]


def _errors(path: Path) -> dict[tuple[str, int, int, int], float]:
    if not os.path.lexists(path):
        return {}
    columns = ("split", *_KEYS, "error")
    rows = tables.read(path, tidy.PLANNING, columns)
    named = zip(*(rows[column].tolist() for column in columns), strict=True)
    return {(split, sequence, start, length): error for split, sequence, start, length, error in named}


def session_of(data: Path, system: str, entry: Entry) -> Session:
    """A recorded session. Raises InputError."""
    chosen = record.load(_store(data, system), slice(entry.place, entry.place + 1))
    members, measure = record.load_members(_store(data, system)), _measure_of(_store(data, system), system)
    weighs = SYSTEMS[system].doubts
    one = {name: np.asarray(values[0]) for name, values in vars(chosen).items()}
    n = entry.length
    states = tuple(one["state"][: n + 1])
    steps = tuple(matched(_step(one, i, n, members, measure, weighs=weighs), states[i], one["cloth"]) for i in range(n))
    title = f"{system}, {entry.split} {entry.title}"
    return Session(title, n, one["goal"], states, steps, tuple(one["centre"][: n + 1]), one["cloth"])


def _measure_of(store: Path, name: str) -> Measure | None:
    """Return which measure of uncertainty the last of a record's terms is, by its attributes; None: they don't tell."""
    if SYSTEMS[name].voxels:
        return "paper"
    told: Any = open_store(store, {}, lengths={}, holds="which a record of sessions holds").attributes
    for key in ("params", "uncertainty", "measure"):
        told = told.get(key) if isinstance(told, dict) else None
    return next((measure for measure in MEASURES if measure == told), None)


def _step(
    one: dict[str, np.ndarray], i: int, length: int, members: tuple[int, ...], measure: Measure | None, *, weighs: bool
) -> Step:
    points, left = one["candidates"][i], length - i
    sigmas = one["prediction_std"][i, :left].astype(np.float32)
    means = np.swapaxes(one["prediction_mean"][i, :left].astype(np.float32), 0, 1)
    progress, manipulations = one["progress"][i], one["plan"][i, :left]
    expected, no_action = _expected(one, i)
    plan = ShownPlan(
        manipulations=manipulations,
        members=members,
        means=means,
        # Predictions in voxels have no standard deviations.
        sigmas=np.swapaxes(sigmas, 0, 1) if sigmas.shape[2:] == means.shape[2:] else None,
        uncertainty=float(one["terms"][i, -1]) if weighs and len(means) > 1 else None,
        loss=float(one["loss"][i]),
        progress=progress[np.isfinite(progress)],
        tried=int(one["tried"][i]),
        improves=not one["cancelled"][i] and not bool(np.all(is_null(manipulations))),
        expected=expected,
        expected_no_action=no_action,
        note=_note(one, i),
        measure=measure,
    )
    return Step(StateEstimate(one["estimate"][i], None, points[np.isfinite(points).all(-1)]), plan)


def _expected(one: dict[str, np.ndarray], i: int) -> tuple[float | None, float | None]:
    """The errors in the labelling that was found, of the predicted outcome and of the estimate; None for voxels."""
    estimate = one["estimate"][i]
    if not is_mesh(estimate):
        return None, None
    goal = relabel(one["goal"], int(one["relative"][i]))
    return float(one["expected"][i]), float(distance_aligned(estimate, goal))


def _note(one: dict[str, np.ndarray], i: int) -> str:
    if not one["null"][i]:
        return "its first manipulation was executed"
    if not one["cancelled"][i]:
        return "not executed: its first manipulation is too short"
    otherwise = float(one["error_otherwise"][i])
    return f"not executed: no improvement was expected (it would have come to {otherwise:.3f})"
