"""The zarr store of meshes, and the record that the rest of the library reads it as (design section 4)."""

import dataclasses
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from jaxtyping import Bool, Float, Int, Int8

from clothkit.cloth.grid import SIDE
from clothkit.dataset.zarr_store import WRITTEN, Declared, Store, open_store
from clothkit.errors import InputError

SPLITS = ("train", "validation", "test")
STATES, STEPS = 4, 3
LENGTHS = {"state": STATES, "step": STEPS, "u": SIDE, "v": SIDE, "xyz": 3, "xy": 2, "component": 6}
"""Dimensions that are as long in every store."""

_CHUNK, _SHARD = 16, 1024
_ARRAYS = {
    "vertices": Declared("f4", ("sequence", "state", "u", "v", "xyz")),
    "centre": Declared("f4", ("sequence", "state", "xy")),
    "manipulation": Declared("f4", ("sequence", "step", "component")),
    "hands": Declared("i1", ("sequence", "step")),
    "length": Declared("i1", ("sequence",)),
    "split": Declared("i1", ("sequence",)),
    "evaluated": Declared("bool", ("sequence",)),
}
_HOLDS = "which a store of meshes holds"

FARTHEST = 1000.0
"""No length is more [normalised]: a file that says so has other units, or is damaged."""


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
    for name, declared in _ARRAYS.items():
        data = np.ascontiguousarray(getattr(dataset, name)).astype(declared.dtype)
        array = group.create_array(
            name,
            shape=data.shape,
            dtype=declared.dtype,
            chunks=(_CHUNK, *data.shape[1:]),
            shards=(_SHARD, *data.shape[1:]),
            dimension_names=declared.dimensions,
            **WRITTEN,
        )
        array[:] = data


def open_meshes(path: Path, names: Collection[str] = tuple(_ARRAYS)) -> Store:
    """A store of meshes whose arrays of those names are as they should be, none of them read. Raises InputError."""
    return open_store(path, {name: _ARRAYS[name] for name in names}, lengths=LENGTHS, holds=_HOLDS)


def load(path: Path) -> Dataset:
    """Read and check a store. Raises InputError naming the file, the array and what was expected."""
    path = Path(path)
    store = open_meshes(path)
    dataset = Dataset(**{name: store.read(name) for name in _ARRAYS})
    _check_splits(path, dataset.split, dataset.length)
    _check_values(path, dataset)
    return dataset


def load_splits(path: Path) -> tuple[Int8[np.ndarray, " sequence"], Int8[np.ndarray, " sequence"]]:
    """Split and length of each sequence of a store, no mesh read. Raises InputError, as `load` does."""
    store = open_meshes(path, ("split", "length"))
    split, length = store.read("split"), store.read("length")
    _check_splits(path, split, length)
    return split, length


def _check_splits(path: Path, split: np.ndarray, length: np.ndarray) -> None:
    for name, values, least, most in (("length", length, 1, STEPS), ("split", split, 0, len(SPLITS) - 1)):
        if np.any((values < least) | (values > most)):
            raise InputError(f"{path}: {name} has values outside {least}..{most}")


def _check_values(path: Path, dataset: Dataset) -> None:
    present = {
        "state": np.arange(STATES) <= dataset.length[:, None],
        "step": np.arange(STEPS) < dataset.length[:, None],
    }
    for name, axis in (("vertices", "state"), ("centre", "state"), ("manipulation", "step")):
        values = getattr(dataset, name)
        rest = tuple(range(2, values.ndim))
        _refuse(path, name, axis, present[axis] & ~np.isfinite(values).all(axis=rest), "is not finite")
        # A NaN, past the end, is no more than anything.
        far = present[axis] & (np.abs(values) > FARTHEST).any(axis=rest)
        _refuse(path, name, axis, far, f"is beyond {FARTHEST:g}, expected normalised lengths")
    _refuse(path, "hands", "step", present["step"] & ~np.isin(dataset.hands, (1, 2)), "is not 1 or 2")


def _refuse(path: Path, name: str, axis: str, bad: Bool[np.ndarray, "sequence place"], what: str) -> None:
    if bad.any():
        sequence, place = np.argwhere(bad)[0]
        raise InputError(f"{path}: {name} of sequence {sequence}, {axis} {place} {what}")
