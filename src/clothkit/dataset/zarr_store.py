"""Zarr stores: the arrays of a store are declared, and are checked against that before anything is read.

Each array lies in shards: files of many chunks, with an index that has a checksum. By default zarr leaves out chunks of
nothing but zeros, and a lost file then reads as zeros. Stores of ours are written with every chunk, each with a
checksum of its contents (`WRITTEN`): a missing shard is refused, and so is a damaged chunk.
"""

import itertools
import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zarr
from zarr.codecs import ZstdCodec

from clothkit.errors import InputError, system_error


class Declared(NamedTuple):
    """What an array of a store is."""

    dtype: str
    dimensions: tuple[str, ...]


WRITTEN: dict[str, Any] = {
    "config": {"write_empty_chunks": True},
    "compressors": ZstdCodec(level=0, checksum=True),
}
"""Options of `zarr.Group.create_array` with which every chunk is written, and its contents have a checksum."""


class Store:
    """A store whose arrays are there, with every shard, and as declared."""

    def __init__(self, path: Path, arrays: Mapping[str, zarr.Array], attributes: dict[str, Any]) -> None:
        self.path = path
        self.attributes = attributes
        """What it says of how it was made."""
        self._arrays = arrays

    def __len__(self) -> int:
        """How long the first dimension is."""
        return next(iter(self._arrays.values())).shape[0]

    def read(self, name: str, chosen: slice = slice(None)) -> np.ndarray:
        """An array, or a stretch of its first dimension. Raises InputError for chunks that are damaged."""
        return read_array(self._arrays[name], f"{self.path}: array {name}", chosen)


def open_node(path: Path) -> zarr.Group | zarr.Array:
    """What a zarr store is at its root. Raises InputError for what is not there, or none."""
    try:
        if not path.is_dir():
            path.stat()
            raise InputError(f"{path}: is a file, expected a zarr store, which is a folder")
        return zarr.open(path, mode="r")
    except OSError as error:
        if error.errno is None:
            raise _unreadable(path, error) from error
        raise system_error(error, path, expected="a zarr store; run the stage that writes it (dvc repro)") from error
    except InputError:
        raise
    except Exception as error:  # zarr tells of damaged metadata by many kinds of errors
        raise _unreadable(path, error) from error


def open_store(path: Path, declared: Mapping[str, Declared], *, lengths: Mapping[str, int], holds: str) -> Store:
    """A store of the declared arrays; `holds` tells what these are, in messages.

    `lengths` are those of the dimensions that have the same in every store; any other may have any length, as long as
    it is the same in all of the declared arrays.

    Raises InputError, naming the array and what was expected, for a store that can't be read, an array that is missing,
    a group, of another shape or kind, and for shards that are missing. No array is read.
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
    """Raises InputError where a file of the array is missing.

    `zeros` is for arrays that others have written: files that hold nothing but zeros need not be there.
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
    """An array, or a stretch of its first dimension. Raises InputError for chunks that are damaged."""
    try:
        return np.asarray(array[chosen] if array.shape else array[...])
    except Exception as error:  # zarr and its codecs tell of damaged chunks by many kinds of errors
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
    # Where arrays differ, most of them are right.
    expected_of = {**{name: counts.most_common(1)[0][0] for name, counts in found.items()}, **lengths}
    for name, array in arrays.items():
        dtype, dimensions = declared[name]
        expected = tuple(expected_of[dimension] for dimension in dimensions if dimension in expected_of)
        if array.shape != expected:
            wanted = ", ".join(dimensions)
            raise InputError(f"{path}: {name} has shape {array.shape}, expected {expected} for ({wanted})")
        if array.dtype != np.dtype(dtype):
            raise InputError(f"{path}: {name} holds {array.dtype}, expected {np.dtype(dtype)}")
        names = getattr(array.metadata, "dimension_names", None)
        if tuple(names or ()) != dimensions:
            raise InputError(f"{path}: {name} has dimensions {names}, expected ({', '.join(dimensions)})")
