"""Weights in 8 bits: whole numbers and a scale per output channel."""

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from flax.traverse_util import flatten_dict, unflatten_dict
from jaxtyping import Float, Int8

from clothkit.runtime.errors import InputError, system_error

SCALE = ".scale"
"""Ending of the name of an array that has the scales of another one."""

LEAST = 4096
"""Arrays of fewer numbers, biases among them, are kept as they are: they are little of a file, and weigh much."""

MOST = 127
"""Largest absolute value of a weight in 8 bits."""


def quantised(weight: Float[np.ndarray, "*inputs out"]) -> tuple[Int8[np.ndarray, "*inputs out"], np.ndarray]:
    """A weight as the nearest whole numbers from -127 to 127, and the scale [out] of each output channel.

    Channels are symmetric: a channel's scale is its largest absolute value / 127, and 0 where all are 0.
    """
    scale = (np.abs(weight).max(axis=tuple(range(weight.ndim - 1))) / MOST).astype(np.float32)
    steps = np.divide(weight, scale, out=np.zeros_like(weight), where=scale > 0)
    return np.clip(np.rint(steps), -MOST, MOST).astype(np.int8), scale


def packed(params: Any, name: str, half: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """The arrays of a net's file, from its weights. `name` is the net's, and begins the names that `half` lists."""
    found: dict[str, np.ndarray] = {}
    for key, value in sorted(flatten_dict(params, sep="/").items()):
        weight = np.asarray(value, np.float32)
        if weight.size < LEAST or weight.ndim < 2:
            found[key] = weight
        elif any(f"{name}/{key}".startswith(beginning) for beginning in half):
            found[key] = weight.astype(np.float16)
        else:
            found[key], found[key + SCALE] = quantised(weight)
    return found


def unpacked(arrays: Mapping[str, np.ndarray]) -> Any:
    """The weights of a net [float32], nested by module and layer. Raises KeyError for 8 bits without a scale."""
    weights = {}
    for key, value in arrays.items():
        if key.endswith(SCALE):
            continue
        scale = arrays[key + SCALE] if value.dtype == np.int8 else np.float32(1)
        weights[key] = value.astype(np.float32) * scale
    return unflatten_dict(weights, sep="/")


def write(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays as a compressed NPZ. Equal arrays give equal bytes."""
    named: Any = arrays
    np.savez_compressed(path, **named)


def read(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a compressed NPZ. Raises InputError for a file that is missing, truncated or something else."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return {name: np.asarray(stored[name]) for name in stored.files}
    except OSError as error:
        if error.errno is not None:
            raise system_error(error, path, expected="a net's packed weights") from error
        raise InputError(f"{path}: expected a net's packed weights, found a truncated or damaged file") from error
    except (ValueError, KeyError, EOFError, AttributeError, TypeError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: expected a net's packed weights, found a truncated or damaged file") from error
