"""Sessions that the pipeline has recorded (planning.record), read one by one."""

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zarr

from clothkit.app.viewer.session import Look, Session, ShownPlan, Step, matched
from clothkit.errors import InputError
from clothkit.evaluation import tidy
from clothkit.planning.record import Sessions
from clothkit.planning.systems import SYSTEMS

_KEYS = ("sequence", "start", "length")


class Entry(NamedTuple):
    """A recorded session, as a list of them has it."""

    place: int
    """Its row in the record."""
    split: str
    sequence: int
    start: int
    length: int
    error: float | None
    """Of its outcome [cloth length]; None where there are no tidy rows beside the record."""

    @property
    def title(self) -> str:
        """What it is called."""
        return f"sequence {self.sequence}, state {self.start} to {self.start + self.length}"

    @property
    def label(self) -> str:
        """Title and error."""
        return self.title if self.error is None else f"{self.title} · error {self.error:.3f}"


def systems_in(data: Path) -> list[str]:
    """The systems whose sessions are recorded under `data`."""
    return [name for name in SYSTEMS if _store(data, name).is_dir()]


def _store(data: Path, system: str) -> Path:
    return data / f"evaluation/planning/sessions_{system}.zarr"


def entries(data: Path, system: str) -> list[Entry]:
    """The recorded sessions of a system, in the record's order. Raises InputError."""
    path = _store(data, system)
    group = _open(path)
    split, sequence, start, length = (_array(path, group, name)[:] for name in ("split", *_KEYS))
    names: Any = group.attrs.get("splits", [])
    if len(split) and int(split.max()) >= len(names):
        raise InputError(f"{path}: attribute splits: expected {int(split.max()) + 1} names, found {len(names)}")
    errors = _errors(data / f"evaluation/planning/{system}.parquet")
    rows = zip([names[k] for k in split], sequence.tolist(), start.tolist(), length.tolist(), strict=True)
    return [Entry(place, *row, errors.get(row)) for place, row in enumerate(rows)]


def _errors(path: Path) -> dict[tuple[str, int, int, int], float]:
    if not path.exists():
        return {}
    columns = ("split", *_KEYS, "error")
    rows = tidy.read(path, columns)
    named = zip(*(rows[column].tolist() for column in columns), strict=True)
    return {(split, sequence, start, length): error for split, sequence, start, length, error in named}


def session_of(data: Path, system: str, entry: Entry) -> Session:
    """A recorded session. Raises InputError."""
    path = _store(data, system)
    group = _open(path)
    one = {
        field.name: np.asarray(_array(path, group, field.name)[entry.place])
        for field in dataclasses.fields(Sessions)
        if field.name != "split"
    }
    n = entry.length
    states = tuple(one["state"][: n + 1])
    steps = tuple(matched(_step(one, i, n), states[i]) for i in range(n))
    title = f"{system}, {entry.split} {entry.title}"
    return Session(title, n, one["goal"], states, steps)


def _step(one: dict[str, np.ndarray], i: int, length: int) -> Step:
    points, left = one["candidates"][i], length - i
    sigmas = one["prediction_std"][i, :left].astype(np.float32)
    means = np.swapaxes(one["prediction_mean"][i, :left].astype(np.float32), 0, 1)
    progress = one["progress"][i]
    plan = ShownPlan(
        manipulations=one["plan"][i, :left],
        means=means,
        # Voxels have none.
        sigmas=np.swapaxes(sigmas, 0, 1) if sigmas.shape[2:] == means.shape[2:] else None,
        uncertainty=float(one["terms"][i, 2]) if len(means) > 1 else None,
        loss=float(one["loss"][i]),
        progress=progress[np.isfinite(progress)],
        tried=one["restarts"].shape[1],
        note=_note(one, i),
    )
    return Step(Look(one["estimate"][i], None, points[np.isfinite(points).all(-1)]), plan)


def _note(one: dict[str, np.ndarray], i: int) -> str:
    if not one["null"][i]:
        return "its first manipulation was executed"
    if not one["cancelled"][i]:
        return "not executed: its first manipulation is too short"
    otherwise = float(one["error_otherwise"][i])
    return f"not executed: no improvement was expected (it would have come to {otherwise:.3f})"


def _open(path: Path) -> zarr.Group:
    try:
        return zarr.open_group(path, mode="r")
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"{path}: can't be read as a zarr group of sessions") from error


def _array(path: Path, group: zarr.Group, name: str) -> Any:
    try:
        return group[name]
    except KeyError as error:
        raise InputError(f"{path}: has no array {name}, which a record of sessions holds") from error
