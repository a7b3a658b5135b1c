"""Zarr stores with a schema, which is written with them, and checked before any array is read.

Each array names its dimensions and its unit, and the group's own file repeats the metadata of all arrays
(`consolidate`), so that xarray opens a store as it is.

An array is stored in shards: files with many chunks and an index that has a checksum. By default, zarr does not write
chunks that contain only zeros, and a lost file then reads as zeros. Our stores are written with every chunk and with a
checksum of its contents (`WRITTEN`), so that a missing shard and a damaged chunk are both detected.
"""

import itertools
import math
import warnings
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zarr
from zarr.codecs import ZstdCodec
from zarr.errors import ZarrUserWarning

from clothkit.runtime.errors import InputError, system_error


class Declared(NamedTuple):
    """The schema of one array of a store."""

    dtype: str
    dimensions: tuple[str, ...]
    units: str = "1"
    """Unit of the values, in the dataset card's words; one for each place of the last dimension where they differ."""


WRITTEN: dict[str, Any] = {
    "config": {"write_empty_chunks": True},
    "compressors": ZstdCodec(level=0, checksum=True),
}
"""Options of `zarr.Group.create_array` that write every chunk, with a checksum of its contents."""


def create_group(path: Path, attributes: Mapping[str, Any]) -> zarr.Group:
    """A new, empty zarr v3 group with these attributes, in the place of what was at `path`."""
    return zarr.open_group(path, mode="w", zarr_format=3, attributes=dict(attributes))


def create_array(
    group: zarr.Group,
    name: str,
    declared: Declared,
    values: np.ndarray,
    *,
    chunk: tuple[int, ...],
    shard: tuple[int, ...],
) -> zarr.Array:
    """Write an array, with the names of its dimensions and its unit, and return it."""
    return group.create_array(
        name,
        data=values,
        chunks=chunk,
        shards=shard,
        dimension_names=declared.dimensions,
        attributes={"units": declared.units},
        **WRITTEN,
    )


def create_empty(
    group: zarr.Group,
    name: str,
    declared: Declared,
    shape: tuple[int, ...],
    *,
    chunk: tuple[int, ...],
    shard: tuple[int, ...],
) -> zarr.Array:
    """As `create_array`, but without values, which are then set shard by shard; all of them must be."""
    return group.create_array(
        name,
        shape=shape,
        dtype=declared.dtype,
        chunks=chunk,
        shards=shard,
        dimension_names=declared.dimensions,
        attributes={"units": declared.units},
        **WRITTEN,
    )


def consolidate(group: zarr.Group) -> None:
    """Repeat the metadata of all arrays of a finished group in the group's own file, which xarray then reads alone."""
    with warnings.catch_warnings():
        # The warning is that this is no part of the specification of zarr v3 yet. Our own reader does without.
        warnings.simplefilter("ignore", ZarrUserWarning)
        zarr.consolidate_metadata(group.store)


class Store:
    """An open store, whose arrays have been checked against the schema."""

    def __init__(self, path: Path, arrays: Mapping[str, zarr.Array], attributes: dict[str, Any]) -> None:
        self.path = path
        self.attributes = attributes
        """Attributes of the store: stage, scale and params, if a stage wrote it."""
        self._arrays = arrays

    def __len__(self) -> int:
        """The length of the first dimension."""
        return next(iter(self._arrays.values())).shape[0]

    def shape(self, name: str) -> tuple[int, ...]:
        """The shape of an array."""
        return self._arrays[name].shape

    def read(self, name: str, chosen: slice = slice(None)) -> np.ndarray:
        """Read an array, or a slice of its first dimension. Raises InputError for damaged chunks."""
        return read_array(self._arrays[name], f"{self.path}: array {name}", chosen)


def open_node(path: Path) -> zarr.Group | zarr.Array:
    """Open the root of a zarr store, a group or an array. Raises InputError if it is missing or not a zarr store."""
    try:
        if not path.is_dir():
            path.stat()
            raise InputError(f"{path}: is a file, expected a zarr store, which is a folder")
        # Each array's own metadata are read, so that their loss or damage is noticed.
        return zarr.open(path, mode="r", use_consolidated=False)
    except OSError as error:
        if error.errno is None:
            raise _unreadable(path, error) from error
        raise system_error(error, path, expected="a zarr store; run the stage that writes it (dvc repro)") from error
    except InputError:
        raise
    except Exception as error:  # zarr raises many types of exceptions for damaged metadata
        raise _unreadable(path, error) from error


def open_store(path: Path, declared: Mapping[str, Declared], *, lengths: Mapping[str, int], holds: str) -> Store:
    """Open a store and check the declared arrays, without reading them; `holds` describes them in error messages.

    `lengths` has the required lengths of some dimensions. Any other dimension may have any length, but the same in all
    declared arrays.

    Raises InputError, which names the array and what was expected, if the store can't be read, if an array is missing,
    is a group, or has another shape, type or dimensions, and if shards are missing.
    """
    path = Path(path)
    group = open_node(path)
    if not isinstance(group, zarr.Group):
        raise InputError(f"{path}: is one array, expected a group of arrays, {holds}")
    arrays = {name: _member(path, group, name, holds) for name in declared}
    _check_shapes(path, arrays, declared, lengths)
    for name, array in arrays.items():
        check_shards(array, f"{path}: array {name}")
    return Store(path, arrays, dict(group.attrs))


def check_shards(array: zarr.Array, name: str, *, zeros: bool = False) -> None:
    """Raises InputError if a shard's file is missing.

    `zeros` is for arrays that other programs wrote, where shards of zeros have no file: then the error is raised only
    if the folder of shards has no files at all.
    """
    parts = array.shards or array.chunks
    counts = [math.ceil(length / part) for length, part in zip(array.shape, parts, strict=True)]
    folder = Path(str(array.store_path.store.root), array.store_path.path)  # type: ignore[attr-defined]
    if zeros:
        shards = folder / "c"
        if math.prod(counts) and shards.is_dir() and not any(file.is_file() for file in shards.rglob("*")):
            raise InputError(f"{name}: its chunks are missing: {shards} holds no file")
        return
    for place in itertools.product(*map(range, counts)):
        key = array.metadata.encode_chunk_key(place)
        if not (folder / key).is_file():
            raise InputError(f"{name}: chunk {key} is missing, expected all {math.prod(counts)} of them")


def read_array(array: zarr.Array, name: str, chosen: slice = slice(None)) -> np.ndarray:
    """Read an array, or a slice of its first dimension. Raises InputError for damaged chunks."""
    try:
        return np.asarray(array[chosen] if array.shape else array[...])
    except Exception as error:  # zarr and its codecs raise many types of exceptions for damaged chunks
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{name}: can't be read, a chunk is damaged ({reason})") from error


def _unreadable(path: Path, error: Exception) -> InputError:
    reason = (str(error).splitlines() or [type(error).__name__])[0]
    return InputError(f"{path}: can't be read as a zarr store ({reason})")


def _member(path: Path, group: zarr.Group, name: str, holds: str) -> zarr.Array:
    try:
        found = group[name]
    except KeyError as error:
        raise InputError(f"{path}: has no array {name}, expected {holds}") from error
    except OSError as error:
        raise system_error(error, path / name, expected="an array") from error
    except Exception as error:  # as in open_node
        raise _unreadable(path / name, error) from error
    if not isinstance(found, zarr.Array):
        raise InputError(f"{path}: {name} is a group, expected an array")
    return found


def _check_shapes(
    path: Path, arrays: Mapping[str, zarr.Array], declared: Mapping[str, Declared], lengths: Mapping[str, int]
) -> None:
    found: dict[str, Counter[int]] = {}
    for name, array in arrays.items():
        for dimension, length in zip(declared[name].dimensions, array.shape, strict=False):
            found.setdefault(dimension, Counter())[length] += 1
    # If arrays disagree about a dimension's length, the most common length is taken as the expected one.
    expected_of = {**{name: counts.most_common(1)[0][0] for name, counts in found.items()}, **lengths}
    for name, array in arrays.items():
        dtype, dimensions, _ = declared[name]
        expected = tuple(expected_of[dimension] for dimension in dimensions if dimension in expected_of)
        if array.shape != expected:
            wanted = ", ".join(dimensions)
            raise InputError(f"{path}: {name} has shape {array.shape}, expected {expected} for ({wanted})")
        if array.dtype != np.dtype(dtype):
            raise InputError(f"{path}: {name} holds {array.dtype}, expected {np.dtype(dtype)}")
        names = getattr(array.metadata, "dimension_names", None)
        if tuple(names or ()) != dimensions:
            raise InputError(f"{path}: {name} has dimensions {names}, expected ({', '.join(dimensions)})")
