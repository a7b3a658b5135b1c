"""Evaluation results as a zarr store: named arrays over evaluated sequences, one shard each."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zarr

from clothkit.errors import InputError


class Named(NamedTuple):
    """An array and the names of its dimensions; the first one is the sequence."""

    values: np.ndarray
    dimensions: tuple[str, ...]


def save(path: Path, arrays: Mapping[str, Named], attributes: Mapping[str, Any]) -> None:
    """Writes a zarr v3 group, a chunk per sequence, one shard per array; the same arrays give the same bytes."""
    group = zarr.open_group(path, mode="w", zarr_format=3, attributes=dict(attributes))
    for name, (values, dimensions) in arrays.items():
        group.create_array(
            name, data=values, chunks=(1, *values.shape[1:]), shards=values.shape, dimension_names=dimensions
        )


def load(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The arrays of those names. Raises InputError if the store or one of them is missing, or holds NaN or infinity.

    Along a dimension `state` or `step`, what lies past a sequence's end is NaN throughout; that is no error.
    """
    try:
        group = zarr.open_group(path, mode="r")
    except (OSError, ValueError) as reason:
        raise InputError(f"{path}: expected a zarr group, could not open it ({reason})") from reason
    found = {}
    for name in names:
        array = group.get(name)
        if not isinstance(array, zarr.Array):
            raise InputError(f"{path}: expected an array {name}, found none")
        values = np.asarray(array[:])
        names_of_dimensions = getattr(array.metadata, "dimension_names", None) or ()
        ending = any(name in ("state", "step") for name in names_of_dimensions[1:2])
        if values.dtype.kind == "f" and not (_ends_whole(values) if ending else np.isfinite(values).all()):
            raise InputError(f"{path}: array {name}: expected finite values, found NaN or infinity")
        found[name] = values
    return found


def _ends_whole(values: np.ndarray) -> bool:
    """Whether each sequence's entries are finite up to some entry, the first at least, and NaN throughout after it."""
    flat = values.reshape(*values.shape[:2], -1)
    present = np.isfinite(flat).all(-1)
    whole = present | np.isnan(flat).all(-1)
    return bool(whole.all() and present[:, 0].all() and (present[:, 1:] <= present[:, :-1]).all())
