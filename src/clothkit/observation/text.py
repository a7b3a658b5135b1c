"""Reads tables of numbers in text, as in point clouds in ASCII files."""

import io
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothkit.runtime.errors import InputError


def numbers(path: Path, data: bytes, *, width: int) -> Float[np.ndarray, "rows width"]:
    """The numbers in all lines that are not blank.

    Raises InputError that shows the first line without exactly `width` numbers.
    """
    if not data.strip():
        return np.zeros((0, width))
    try:
        table = np.loadtxt(io.TextIOWrapper(io.BytesIO(data), "latin-1"), comments=None, ndmin=2)
    except ValueError as error:
        raise _no_row(path, data, width, error) from error
    if table.shape[1] != width:
        raise _no_row(path, data, width, None)
    return table


def short(path: Path, found: int, points: int) -> InputError:
    """The error for a file with fewer points than its header says."""
    return InputError(f"{path}: ends after {found} points, its header says {points}")


def _no_row(path: Path, data: bytes, width: int, error: ValueError | None) -> InputError:
    """The error that shows the first row that can't be read; NumPy's message says where to search for it."""
    number = re.search(r"at row (\d+)", str(error))
    row = int(number[1]) if number else 0
    lines = (line for line in data.decode("latin-1").splitlines() if line.strip())
    for index, line in enumerate(lines):
        words = line.split()
        # NumPy's messages count rows from 0 in some cases and from 1 in others.
        if index >= row - 1 and not _are_numbers(words, width):
            return InputError(f"{path}: point {index} is {' '.join(words)[:60]!r}, expected {width} numbers")
    return InputError(f"{path}: can't be read as ASCII, expected {width} numbers in each line")


def _are_numbers(words: list[str], width: int) -> bool:
    try:
        return len([float(word) for word in words]) == width
    except ValueError:
        return False
