"""The zarr store of meshes, and the class `Dataset` that holds its contents (design section 4)."""

import dataclasses
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zarr
from jaxtyping import Bool, Float, Int, Int8

from clothkit.cloth.topology import CLOTH_LENGTH, PAPERS_CLOTH, SQUARE
from clothkit.dataset.zarr_store import Declared, Store, consolidate, create_empty, create_group, open_store
from clothkit.runtime.errors import InputError
from clothkit.simulation.cloths import Cloths
from clothkit.simulation.material import Material
from clothkit.simulation.settings import DRAWN, STARTS

SPLITS = ("train", "validation", "test")
STATES, STEPS = 4, 3
_ROWS, _COLUMNS = SQUARE.shape
LENGTHS = {
    "state": STATES,
    "step": STEPS,
    "u": _ROWS,
    "v": _COLUMNS,
    "xyz": 3,
    "xy": 2,
    "component": 6,
    "measure": 3,
    "property": len(DRAWN),
}
"""Lengths of the dimensions that are the same in every store."""

NORMALISED = "normalised"
"""Unit of lengths of which the flat cloth's longer side is CLOTH_LENGTH."""

MANIPULATION_UNITS = ", ".join(("geodesic",) * 4 + (NORMALISED,) * 2)
PROPERTY_UNITS = ("m", "kg/m^2", "N/m", "N/m", "N m", "1/m", "1", "1")
"""Units of the properties in DRAWN."""

LABELS = {
    "xyz": ("x", "y", "z"),
    "xy": ("x", "y"),
    "component": ("u1", "v1", "u2", "v2", "dx", "dy"),
    "measure": ("side_u", "side_v", "thickness"),
    "property": DRAWN,
}
"""Names of the places along a dimension, kept in the attribute `labels` of every store that has such a dimension."""

_CHUNK = 16
SHARD = 1024
"""Sequences in a shard's file, and so the most that a writer or a reader of parts holds at a time."""

_ARRAYS = {
    "vertices": Declared("f4", ("sequence", "state", "u", "v", "xyz"), NORMALISED),
    "centre": Declared("f4", ("sequence", "state", "xy"), NORMALISED),
    "manipulation": Declared("f4", ("sequence", "step", "component"), MANIPULATION_UNITS),
    "hands": Declared("i1", ("sequence", "step")),
    "length": Declared("i1", ("sequence",)),
    "split": Declared("i1", ("sequence",)),
    "evaluated": Declared("bool", ("sequence",)),
    "cloth": Declared("f4", ("sequence", "measure"), NORMALISED),
    "start": Declared("i1", ("sequence",)),
    "material": Declared("f4", ("sequence", "property"), ", ".join(PROPERTY_UNITS)),
}
_HOLDS = "which a store of meshes holds"


def papers_cloths(sequences: int) -> Cloths:
    """The paper's cloth for each sequence, lying flat at first."""
    material = np.array([getattr(Material(), name) for name in DRAWN], np.float32)
    return Cloths(
        np.tile(PAPERS_CLOTH, (sequences, 1)), np.zeros(sequences, np.int8), np.tile(material, (sequences, 1))
    )


FARTHEST = 1000.0
"""Largest accepted absolute value [normalised]; a file with larger ones is damaged or in another unit."""


@dataclasses.dataclass(frozen=True)
class Dataset:
    """Sequences of states and manipulations in normalised units. Values after a sequence's end are NaN."""

    vertices: Float[np.ndarray, "sequence state u v 3"]
    """Meshes, centred."""
    centre: Float[np.ndarray, "sequence state 2"]
    """Position of each mesh's centre on the table before centring."""
    manipulation: Float[np.ndarray, "sequence step 6"]
    """u1 v1 u2 v2 dx dy; one-handed manipulations repeat the grasp point."""
    hands: Int8[np.ndarray, "sequence step"]
    length: Int8[np.ndarray, " sequence"]
    """Number of manipulations in the sequence, 1..3."""
    split: Int8[np.ndarray, " sequence"]
    """Index into SPLITS."""
    evaluated: Bool[np.ndarray, " sequence"]
    """Whether evaluations use the sequence."""
    cloth: Float[np.ndarray, "sequence 3"]
    """What a ruler tells of the cloth: its sides along u and along v, and its thickness."""
    start: Int8[np.ndarray, " sequence"]
    """How the cloth came to lie as it did at first: index into STARTS."""
    material: Float[np.ndarray, "sequence properties"]
    """The properties in DRAWN of the simulated cloth, in SI units; NaN where a simulator did not tell them."""

    def __len__(self) -> int:
        return len(self.length)

    def take(self, index: Int[np.ndarray, " taken"] | Bool[np.ndarray, " sequence"] | slice) -> "Dataset":
        """The sequences chosen by an index array, a mask or a slice."""
        return Dataset(*(getattr(self, field.name)[index] for field in dataclasses.fields(self)))

    def cloths(self, sequence: Int[np.ndarray, " n"]) -> Cloths:
        """The cloths of the sequences with these indices."""
        return Cloths(self.cloth[sequence], self.start[sequence], self.material[sequence])

    def indices(self, split: str, *, evaluated: bool = False) -> Int[np.ndarray, " chosen"]:
        """Sorted indices of the sequences of one split; with `evaluated`, only of those that evaluations use."""
        chosen = self.split == SPLITS.index(split)
        return np.flatnonzero(chosen & self.evaluated if evaluated else chosen)

    def of_split(self, split: str, *, evaluated: bool = False) -> "Dataset":
        """The sequences of one split; with `evaluated`, only those that evaluations use."""
        return self.take(self.indices(split, evaluated=evaluated))


class Parts(NamedTuple):
    """A dataset that comes in parts, each of SHARD sequences but for the last, so that it need not fit into memory."""

    sequences: int
    """How many all parts have."""
    each: Iterable[Dataset]


def in_parts(dataset: Dataset) -> Parts:
    """The parts of a dataset."""
    firsts = range(0, max(1, len(dataset)), SHARD)
    return Parts(len(dataset), (dataset.take(slice(first, first + SHARD)) for first in firsts))


def join(parts: Parts) -> Dataset:
    """The dataset of the parts, in memory."""
    found = list(parts.each)
    fields = [field.name for field in dataclasses.fields(Dataset)]
    return Dataset(*(np.concatenate([getattr(part, name) for part in found]) for name in fields))


def save(path: Path, dataset: Dataset, attributes: dict[str, Any]) -> None:
    """Write a dataset as a zarr v3 directory with few shard files; equal datasets give equal bytes."""
    save_parts(path, in_parts(dataset), attributes)


def save_parts(path: Path, parts: Parts, attributes: dict[str, Any]) -> None:
    """Write the bytes that `save` writes of the joined parts, a shard at a time."""
    group = create_group(path, {**attributes, "splits": list(SPLITS), "labels": labels_of(_ARRAYS)})
    arrays: dict[str, zarr.Array] = {}
    first = 0
    for part in parts.each:
        for name, declared in _ARRAYS.items():
            values = np.ascontiguousarray(getattr(part, name), declared.dtype)
            if name not in arrays:
                shape, rest = (parts.sequences, *values.shape[1:]), values.shape[1:]
                arrays[name] = create_empty(group, name, declared, shape, chunk=(_CHUNK, *rest), shard=(SHARD, *rest))
            arrays[name][first : first + len(part)] = values
        first += len(part)
    if first != parts.sequences:
        raise ValueError(f"parts have {first} sequences, expected {parts.sequences}")
    consolidate(group)


def labels_of(declared: Mapping[str, Declared]) -> dict[str, list[str]]:
    """The LABELS of those dimensions that the declared arrays have."""
    present = {dimension for array in declared.values() for dimension in array.dimensions}
    return {dimension: list(names) for dimension, names in LABELS.items() if dimension in present}


def open_meshes(path: Path, names: Collection[str] = tuple(_ARRAYS)) -> Store:
    """Open a store of meshes and check the schema of the named arrays, without reading them.

    Raises InputError if an array is missing, has missing files or is not as declared.
    """
    return open_store(path, {name: _ARRAYS[name] for name in names}, lengths=LENGTHS, holds=_HOLDS)


def load(path: Path) -> Dataset:
    """Read and check a store of meshes.

    Raises InputError, which names the file, the array and what was expected, for a store that is missing, damaged, not
    as declared, or has values out of range.
    """
    path = Path(path)
    store = open_meshes(path)
    dataset = Dataset(**{name: store.read(name) for name in _ARRAYS})
    _check_splits(path, dataset.split, dataset.length)
    _check_values(path, dataset, np.arange(len(dataset)))
    return dataset


def load_parts(path: Path, rows: Int[np.ndarray, " rows"]) -> Iterator[Dataset]:
    """Read and check the sequences with these indices, which do not fall, SHARD of them at a time.

    An index may come several times. Raises InputError, as `load` does, once it comes to what is damaged.
    """
    store = open_meshes(path)
    for chosen in (rows[first : first + SHARD] for first in range(0, len(rows), SHARD)):
        # Chosen sequences may lie far apart: no more than a shard around them is read at a time.
        pieces = []
        for shard in np.unique(chosen // SHARD):
            own = chosen[chosen // SHARD == shard]
            span = slice(int(own[0]), int(own[-1]) + 1)
            pieces.append(Dataset(**{name: store.read(name, span)[own - own[0]] for name in _ARRAYS}))
        part = join(Parts(len(chosen), pieces))
        _check_splits(path, part.split, part.length)
        _check_values(path, part, chosen)
        yield part


def load_splits(path: Path) -> tuple[Int8[np.ndarray, " sequence"], Int8[np.ndarray, " sequence"]]:
    """Read the split and length of each sequence of a store, without its meshes. Raises InputError, as `load` does."""
    store = open_meshes(path, ("split", "length"))
    split, length = store.read("split"), store.read("length")
    _check_splits(path, split, length)
    return split, length


def _check_splits(path: Path, split: np.ndarray, length: np.ndarray) -> None:
    for name, values, least, most in (("length", length, 1, STEPS), ("split", split, 0, len(SPLITS) - 1)):
        if np.any((values < least) | (values > most)):
            raise InputError(f"{path}: {name} has values outside {least}..{most}")


def _check_values(path: Path, dataset: Dataset, sequences: Int[np.ndarray, " sequence"]) -> None:
    present = {
        "state": np.arange(STATES) <= dataset.length[:, None],
        "step": np.arange(STEPS) < dataset.length[:, None],
    }

    def refuse(name: str, axis: str, bad: Bool[np.ndarray, "sequence place"], what: str) -> None:
        if bad.any():
            row, place = np.argwhere(bad)[0]
            raise InputError(f"{path}: {name} of sequence {sequences[row]}, {axis} {place} {what}")

    for name, axis in (("vertices", "state"), ("centre", "state"), ("manipulation", "step")):
        values = getattr(dataset, name)
        rest = tuple(range(2, values.ndim))
        refuse(name, axis, present[axis] & ~np.isfinite(values).all(axis=rest), "is not finite")
        far = present[axis] & (np.abs(values) > FARTHEST).any(axis=rest)
        refuse(name, axis, far, f"is beyond {FARTHEST:g}, expected normalised lengths")
    known = np.isfinite(dataset.cloth) & (dataset.cloth > 0) & (dataset.cloth < CLOTH_LENGTH + 1e-4)
    refuse("cloth", "measure", ~known, f"is not above 0 and at most {CLOTH_LENGTH:g}")
    started = (dataset.start >= 0) & (dataset.start < len(STARTS))
    refuse("start", "value", ~started[:, None], f"is not from 0 to {len(STARTS) - 1}")
    refuse("hands", "step", present["step"] & ~np.isin(dataset.hands, (1, 2)), "is not 1 or 2")
