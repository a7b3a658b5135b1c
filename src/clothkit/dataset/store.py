"""The zarr store of meshes, and the record that the rest of the library reads it as (design section 4)."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from jaxtyping import Bool, Float, Int, Int8

from clothkit.cloth.grid import SIDE
from clothkit.errors import InputError

SPLITS = ("train", "validation", "test")
STATES, STEPS = 4, 3
_CHUNK, _SHARD = 16, 1024
_SHAPES: dict[str, tuple[tuple[int, ...], str, tuple[str, ...]]] = {
    "vertices": ((STATES, SIDE, SIDE, 3), "f4", ("state", "u", "v", "xyz")),
    "centre": ((STATES, 2), "f4", ("state", "xy")),
    "manipulation": ((STEPS, 6), "f4", ("step", "component")),
    "hands": ((STEPS,), "i1", ("step",)),
    "length": ((), "i1", ()),
    "split": ((), "i1", ()),
    "evaluated": ((), "bool", ()),
}


@dataclasses.dataclass(frozen=True)
class Dataset:
    """Sequences of states and manipulations. Normalised units; states past a sequence's length are NaN."""

    vertices: Float[np.ndarray, "sequence state u v 3"]
    """Meshes, centred."""
    centre: Float[np.ndarray, "sequence state 2"]
    """Where each mesh's centre was."""
    manipulation: Float[np.ndarray, "sequence step 6"]
    """u1 v1 u2 v2 dx dy; one hand: the grasp point twice."""
    hands: Int8[np.ndarray, "sequence step"]
    length: Int8[np.ndarray, " sequence"]
    """Manipulations in the sequence, 1..3."""
    split: Int8[np.ndarray, " sequence"]
    """Index into SPLITS."""
    evaluated: Bool[np.ndarray, " sequence"]
    """Whether evaluations use the sequence."""

    def __len__(self) -> int:
        return len(self.length)

    def take(self, index: Int[np.ndarray, " taken"] | Bool[np.ndarray, " sequence"] | slice) -> "Dataset":
        """The chosen sequences."""
        return Dataset(*(getattr(self, field.name)[index] for field in dataclasses.fields(self)))

    def indices(self, split: str, *, evaluated: bool = False) -> Int[np.ndarray, " chosen"]:
        """The numbers of the sequences of one split, in order; of those that evaluations use if `evaluated`."""
        chosen = self.split == SPLITS.index(split)
        return np.flatnonzero(chosen & self.evaluated if evaluated else chosen)

    def of_split(self, split: str, *, evaluated: bool = False) -> "Dataset":
        """The sequences of one split."""
        return self.take(self.indices(split, evaluated=evaluated))


def save(path: Path, dataset: Dataset, attributes: dict[str, Any]) -> None:
    """Write a dataset as a zarr v3 directory of a handful of shards; the same dataset gives the same bytes."""
    group = zarr.create_group(path, overwrite=True, attributes={**attributes, "splits": list(SPLITS)})
    for name, (_, dtype, dimensions) in _SHAPES.items():
        data = np.ascontiguousarray(getattr(dataset, name)).astype(dtype)
        array = group.create_array(
            name,
            shape=data.shape,
            dtype=dtype,
            chunks=(_CHUNK, *data.shape[1:]),
            shards=(_SHARD, *data.shape[1:]),
            dimension_names=("sequence", *dimensions),
        )
        array[:] = data


def load(path: Path) -> Dataset:
    """Read and check a store. Raises InputError naming the file, the array and what was expected."""
    if not Path(path).exists():
        raise InputError(f"{path}: not found; run the stage that writes it (dvc repro)")
    try:
        group = zarr.open_group(path, mode="r")
        arrays = {name: np.asarray(group[name][:]) for name in _SHAPES}  # type: ignore[index]
    except KeyError as error:
        raise InputError(f"{path}: has no array {error}, which a store of meshes holds") from error
    except (OSError, ValueError, RuntimeError, json.JSONDecodeError) as error:
        raise InputError(f"{path}: can't be read as a zarr store ({str(error).splitlines()[0]})") from error
    count = len(arrays["length"])
    for name, (shape, dtype, dimensions) in _SHAPES.items():
        found = arrays[name].shape
        if found != (count, *shape):
            wanted = ", ".join(("sequence", *dimensions))
            raise InputError(f"{path}: {name} has shape {found}, expected {(count, *shape)} for ({wanted})")
        if arrays[name].dtype != np.dtype(dtype):
            raise InputError(f"{path}: {name} holds {arrays[name].dtype}, expected {np.dtype(dtype)}")
    dataset = Dataset(**arrays)
    _check_finite(Path(path), dataset)
    return dataset


def _check_finite(path: Path, dataset: Dataset) -> None:
    if np.any((dataset.length < 1) | (dataset.length > STEPS)):
        raise InputError(f"{path}: length has values outside 1..{STEPS}")
    present = {
        "state": np.arange(STATES) <= dataset.length[:, None],
        "step": np.arange(STEPS) < dataset.length[:, None],
    }
    for name, axis in (("vertices", "state"), ("centre", "state"), ("manipulation", "step")):
        values = getattr(dataset, name)
        finite = np.isfinite(values).all(axis=tuple(range(2, values.ndim)))
        bad = np.argwhere(present[axis] & ~finite)
        if len(bad):
            sequence, position = bad[0]
            raise InputError(f"{path}: {name} of sequence {sequence}, {axis} {position} is not finite")
