"""Evaluation results as a zarr store: named arrays over the evaluated sequences, one shard per array."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from clothkit.cloth.voxels import RESOLUTION
from clothkit.dataset.store import LENGTHS, NORMALISED, STATES, labels_of
from clothkit.dataset.zarr_store import Declared, consolidate, create_array, create_group, open_store
from clothkit.runtime.errors import InputError

_LENGTHS = {**LENGTHS, **dict(zip("xyz", RESOLUTION, strict=True))}
_VERTICES = ("u", "v", "xyz")
_NUMBERS = Declared("i8", ("sequence",))

ESTIMATES = {
    "sequence": _NUMBERS,
    "mean": Declared("f4", ("sequence", "state", *_VERTICES), NORMALISED),
    "std": Declared("f4", ("sequence", "state", *_VERTICES), NORMALISED),
    "mesh": Declared("f4", ("sequence", "state", *_VERTICES), NORMALISED),
    "label": Declared("i4", ("sequence", "state")),
}
PREDICTIONS = {
    "sequence": _NUMBERS,
    "start": Declared("f4", ("sequence", *_VERTICES), NORMALISED),
    "mean": Declared("f4", ("sequence", "step", *_VERTICES), NORMALISED),
    "std": Declared("f4", ("sequence", "step", *_VERTICES), NORMALISED),
    "shift": Declared("f4", ("sequence", "step", "xy"), NORMALISED),
}
PICTURES = {
    "sequence": _NUMBERS,
    "shown": Declared("i8", ("sequence",)),
    "height": Declared("f4", ("sequence", "condition", "row", "column"), "m"),
    "voxels": Declared("bool", ("sequence", "condition", "x", "y", "z")),
    "mesh": Declared("f4", ("sequence", "condition", *_VERTICES), NORMALISED),
}


def save(
    path: Path, arrays: Mapping[str, np.ndarray], declared: Mapping[str, Declared], attributes: Mapping[str, Any]
) -> None:
    """Write the declared arrays as a zarr v3 group, a chunk per sequence and one shard per array.

    Equal arrays give equal bytes.
    """
    group = create_group(path, {**attributes, "labels": labels_of(declared)})
    for name, values in arrays.items():
        if name not in declared:
            continue
        create_array(group, name, declared[name], values, chunk=(1, *values.shape[1:]), shard=values.shape)
    consolidate(group)


def load(path: Path, declared: Mapping[str, Declared], names: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
    """Read the declared arrays, or only those in `names`.

    Raises InputError if the store or an array is missing, damaged or not as declared, if it holds NaN, infinity or
    values out of range, or if a sequence occurs twice. Along a dimension `state` or `step`, entries past a sequence's
    end are NaN, which is no error.
    """
    chosen = {name: declared[name] for name in names or declared}
    store = open_store(path, chosen, lengths=_LENGTHS, holds="a result of an evaluation")
    found = {name: store.read(name) for name in chosen}
    for name, values in found.items():
        ending = chosen[name].dimensions[1:2] in (("state",), ("step",))
        if values.dtype.kind == "f" and not (_ends_whole(values) if ending else np.isfinite(values).all()):
            raise InputError(f"{path}: array {name}: expected finite values, found NaN or infinity")
    _check_values(path, found)
    return found


def _check_values(path: Path, found: Mapping[str, np.ndarray]) -> None:
    """Raise InputError for sequences, states, labels and standard deviations that are out of range."""
    sequence = found.get("sequence", np.arange(0))
    if len(np.unique(sequence)) < len(sequence) or np.any(sequence < 0):
        raise InputError(f"{path}: array sequence: expected another sequence in each row, from 0 on")
    if "std" in found and np.any(found["std"] <= 0):
        raise InputError(f"{path}: array std: expected values above 0")
    if "shown" in found and np.any((found["shown"] < 1) | (found["shown"] >= STATES)):
        raise InputError(f"{path}: array shown: expected states 1 to {STATES - 1}")
    if "label" in found:
        label = found["label"]
        if np.any((label < -1) | (label > 7)):
            raise InputError(f"{path}: array label: expected labels 0 to 7, -1 past a sequence's end")
        if "mesh" in found and np.any((label < 0) != np.isnan(found["mesh"]).all((2, 3, 4))):
            raise InputError(f"{path}: array label: expected -1 past a sequence's end alone, where mesh is NaN")


def _ends_whole(values: np.ndarray) -> bool:
    """Return whether each sequence has at least one finite entry first, and only NaN after its last finite entry."""
    flat = values.reshape(*values.shape[:2], -1)
    present = np.isfinite(flat).all(-1)
    whole = present | np.isnan(flat).all(-1)
    return bool(whole.all() and present[:, 0].all() and (present[:, 1:] <= present[:, :-1]).all())
