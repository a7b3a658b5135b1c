"""Decodes the colours of points: packed into one number, or red, green and blue as integers or as floats 0..1."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Shaped, UInt8

_PACKED = ("rgb", "rgba")
_APART = (("r", "g", "b"), ("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"))


def colours_of(columns: Mapping[str, np.ndarray]) -> UInt8[np.ndarray, "points 3"] | None:
    """Red, green and blue of points from the columns of a table of points; None if no columns hold valid colours."""
    for names in _APART:
        if all(name in columns for name in names):
            return as_bytes(np.stack([columns[name] for name in names], axis=-1))
    name = next((name for name in _PACKED if name in columns), None)
    return None if name is None else unpacked(columns[name])


def as_bytes(colours: Shaped[np.ndarray, "points 3"]) -> UInt8[np.ndarray, "points 3"] | None:
    """Colours as bytes, from whole numbers 0..255 or floats 0..1; None if the values are neither.

    Floats that are not finite, which cameras write where they measured nothing, become 0.
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
    """Red, green and blue that PCL packed into the bytes of a float or an integer; None for other types."""
    if numbers.ndim != 1 or numbers.dtype.kind not in "iuf":
        return None
    if numbers.dtype.kind == "f":
        if numbers.dtype.itemsize not in (4, 8):
            return None
        finite = numbers[np.isfinite(numbers)]
        # Text files hold the integer, such as 16711680, or the float with the same bits, 2.3e-38. No float with the
        # bits of a colour is a whole number of 1 or more, so such numbers are the integers.
        if finite.size and (finite == np.rint(finite)).all() and 1 <= finite.max() < 2**32 and finite.min() >= 0:
            return unpacked(np.nan_to_num(numbers).astype(np.int64))
        bits = np.ascontiguousarray(numbers.astype(np.float32)).view(np.uint32)
    else:
        bits = numbers.astype(np.int64).astype(np.uint32)
    return np.stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255], axis=-1).astype(np.uint8)
