"""Colours of points as files hold them: packed into one number, or red, green and blue, whole or as shares of 1."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Shaped, UInt8

_PACKED = ("rgb", "rgba")
_APART = (("r", "g", "b"), ("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"))


def colours_of(columns: Mapping[str, np.ndarray]) -> UInt8[np.ndarray, "points 3"] | None:
    """Red, green and blue of points from the columns of a table of points; None if no columns are colours."""
    for names in _APART:
        if all(name in columns for name in names):
            return as_bytes(np.stack([columns[name] for name in names], axis=-1))
    name = next((name for name in _PACKED if name in columns), None)
    return None if name is None else unpacked(columns[name])


def as_bytes(colours: Shaped[np.ndarray, "points 3"]) -> UInt8[np.ndarray, "points 3"] | None:
    """Colours of 0 to 255; of floats at most 1 they are shares of 1. None if they are neither.

    Floats that are not finite, as cameras have them where they measured nothing, become 0.
    """
    if colours.dtype.kind not in "iuf":
        return None
    if colours.dtype.kind == "f":
        colours = np.where(np.isfinite(colours), colours, 0)
    if not colours.size:
        return np.zeros(colours.shape, np.uint8)
    low, high = colours.min(), colours.max()
    if colours.dtype.kind == "f" and low >= 0 and high <= 1:
        return np.rint(colours * 255).astype(np.uint8)
    if low >= 0 and high <= 255 and (colours == np.rint(colours)).all():
        return colours.astype(np.uint8)
    return None


def unpacked(numbers: Shaped[np.ndarray, " points"]) -> UInt8[np.ndarray, "points 3"] | None:
    """Red, green and blue, which PCL packs into the bytes of a float or of a whole number. None of other types."""
    if numbers.ndim != 1 or numbers.dtype.kind not in "iuf":
        return None
    if numbers.dtype.kind == "f":
        if numbers.dtype.itemsize not in (4, 8):
            return None
        finite = numbers[np.isfinite(numbers)]
        # Text says 16711680 or, as the float of the same bits, 2.3e-38. As a float no colour is a whole number from 1.
        if finite.size and (finite == np.rint(finite)).all() and 1 <= finite.max() < 2**32 and finite.min() >= 0:
            return unpacked(np.nan_to_num(numbers).astype(np.int64))
        bits = np.ascontiguousarray(numbers.astype(np.float32)).view(np.uint32)
    else:
        bits = numbers.astype(np.int64).astype(np.uint32)
    return np.stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255], axis=-1).astype(np.uint8)
