"""Reads point clouds in PCD files (Point Cloud Library, versions .5 to .7): ASCII, binary and compressed by LZF."""

import re
import struct
from pathlib import Path
from typing import NamedTuple

import lzf
import numpy as np

from clothkit.observation.colours import colours_of
from clothkit.observation.states import PointCloud
from clothkit.observation.text import numbers, short
from clothkit.runtime.errors import InputError, system_error

_KINDS = {"F": "f", "U": "u", "I": "i"}
_SIZES = ("1", "2", "4", "8")
_NEEDED = ("FIELDS", "SIZE", "TYPE", "DATA")
_MOST_LINES = 200  # of a header, comments included
_USED = ("x", "y", "z", "rgb", "rgba", "r", "g", "b")
_LZF_RATIO = 128
"""Upper bound of the compression ratio: LZF unpacks 3 bytes to at most 264."""


class Field(NamedTuple):
    """A field of a point: `numbers` values of one type."""

    name: str
    type: np.dtype
    numbers: int

    @property
    def size(self) -> int:
        """Bytes per point."""
        return self.type.itemsize * self.numbers


def read_pcd(path: Path) -> PointCloud:
    """The cloud in a PCD file with its viewpoint, and with colours if it has `rgb`, `rgba`, or `r`, `g`, `b`.

    A viewpoint at the origin is ignored: programs write the origin, in any frame, when they don't know the viewpoint.
    Raises InputError when the header is not that of a PCD file, contradicts itself or the data, or lacks x, y or z. The
    sizes in the header are checked against the file's size before memory is allocated.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise system_error(error, path, expected="a point cloud") from error
    header, begin = _header(path, content)
    fields = _fields(path, header)
    points = _points(path, header)
    if not points:
        raise InputError(f"{path}: holds no points, its view is empty")
    encoding = header["DATA"][0].lower()
    least = 2 * sum(field.numbers for field in fields) if encoding == "ascii" else sum(field.size for field in fields)
    if least > len(content):
        raise InputError(f"{path}: by its header a point takes {least} bytes, the file has {len(content)}")
    readers = {"ascii": _ascii, "binary": _binary, "binary_compressed": _compressed}
    if encoding not in readers:
        raise InputError(f"{path}: DATA is {encoding}, expected {', '.join(readers)}")
    # Cameras write many kinds of NaN, some of which raise a warning when they are converted.
    with np.errstate(invalid="ignore"):
        columns = readers[encoding](path, content[begin:], fields, points)
        xyz = np.stack([columns[axis].astype(float) for axis in "xyz"], axis=-1)
        return PointCloud(xyz, colours=colours_of(columns), viewpoint=_viewpoint(path, header))


def _header(path: Path, content: bytes) -> tuple[dict[str, list[str]], int]:
    """The header's entries by name, and the offset at which the data begin [bytes]."""
    header: dict[str, list[str]] = {}
    position, lines = 0, 0
    while "DATA" not in header:
        end = content.find(b"\n", position)
        line = content[position:end].decode("ascii", "replace").split() if end >= 0 else None
        lines += 1
        if line is None or lines > _MOST_LINES:
            raise InputError(f"{path}: is no PCD file, its header has no line DATA")
        if line and not line[0].startswith("#"):
            name = line[0].upper()
            header["FIELDS" if name == "COLUMNS" else name] = line[1:]
        position = end + 1
    missing = [name for name in _NEEDED if not header.get(name)]
    if missing:
        raise InputError(f"{path}: is no PCD file, its header has no line {missing[0]}")
    return header, position


def _points(path: Path, header: dict[str, list[str]]) -> int:
    """The number of points: POINTS, or WIDTH times HEIGHT. Raises InputError when they differ or both are missing."""
    said = {}
    for name in ("POINTS", "WIDTH", "HEIGHT"):
        words = header.get(name)
        if words is None:
            continue
        word = " ".join(words)
        if not re.fullmatch(r"\d{1,18}", word):
            raise InputError(f"{path}: {name} is {word!r} in its header, expected a whole number")
        said[name] = int(word)
    area = said["WIDTH"] * said.get("HEIGHT", 1) if "WIDTH" in said else None
    points = said.get("POINTS", area)
    if points is None:
        raise InputError(f"{path}: is no PCD file, its header has neither POINTS nor WIDTH")
    if area not in (None, points):
        raise InputError(f"{path}: POINTS is {points} in its header, but WIDTH times HEIGHT is {area}")
    return points


def _fields(path: Path, header: dict[str, list[str]]) -> list[Field]:
    """The fields of a point, in order."""
    names, sizes, kinds = header["FIELDS"], header["SIZE"], header["TYPE"]
    counts = header.get("COUNT", ["1"] * len(names))
    if not len(names) == len(sizes) == len(kinds) == len(counts):
        raise InputError(f"{path}: FIELDS, SIZE, TYPE and COUNT of its header differ in length")
    for axis in "xyz":
        if axis not in names:
            raise InputError(f"{path}: has no field {axis}, its fields are {' '.join(names)}")
    fields = []
    for name, size, kind, count in zip(names, sizes, kinds, counts, strict=True):
        if name in _USED and names.count(name) > 1:
            raise InputError(f"{path}: has field {name} {names.count(name)} times, expected it once")
        try:
            one = np.dtype(f"<{_KINDS[kind]}{size}")
            each = int(count) if re.fullmatch(r"\d{1,18}", count) else 0
            if size not in _SIZES or each < 1 or (name in _USED and each > 1):
                raise ValueError
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path}: field {name} has type {kind}, size {size}, count {count}: unknown") from error
        fields.append(Field(name, one, each))
    return fields


def _ascii(path: Path, data: bytes, fields: list[Field], points: int) -> dict[str, np.ndarray]:
    table = numbers(path, data, width=sum(field.numbers for field in fields))
    if len(table) < points:
        raise short(path, len(table), points)
    if len(table) > points:
        raise InputError(f"{path}: goes on after the {points} points that its header says")
    columns, first = {}, 0
    for field in fields:
        if field.name in _USED:
            column = table[:, first]
            columns[field.name] = column if field.type.kind == "f" else column.astype(np.int64)
        first += field.numbers
    return columns


def _binary(path: Path, data: bytes, fields: list[Field], points: int) -> dict[str, np.ndarray]:
    size = sum(field.size for field in fields)
    if len(data) < points * size:
        raise short(path, len(data) // size, points)
    columns, first = {}, 0
    for field in fields:
        if field.name in _USED:
            columns[field.name] = np.ndarray(points, field.type, data, offset=first, strides=(size,))
        first += field.size
    return columns


def _compressed(path: Path, data: bytes, fields: list[Field], points: int) -> dict[str, np.ndarray]:
    """The columns of compressed data: the first field of all points, then the second, ..., compressed as one block."""
    expected = points * sum(field.size for field in fields)
    if len(data) < 8:
        raise short(path, 0, points)
    compressed, size = struct.unpack_from("<II", data)
    if size != expected:
        raise InputError(f"{path}: its data unpack to {size} bytes, but {points} points take {expected}")
    if compressed > len(data) - 8 or size > _LZF_RATIO * compressed:
        raise InputError(f"{path}: ends too early, or is broken: {len(data) - 8} bytes of compressed data")
    try:
        unpacked = lzf.decompress(data[8 : 8 + compressed], size)
    except Exception as error:  # a C extension with its own errors
        raise InputError(f"{path}: its compressed data are broken") from error
    if unpacked is None or len(unpacked) != size:
        raise InputError(f"{path}: its compressed data are broken")
    columns, first = {}, 0
    for field in fields:
        if field.name in _USED:
            columns[field.name] = np.frombuffer(unpacked, field.type, count=points, offset=first)
        first += field.size * points
    return columns


def _viewpoint(path: Path, header: dict[str, list[str]]) -> np.ndarray | None:
    """The camera's position [m]; None if it is the origin."""
    values = header.get("VIEWPOINT", ["0"] * 7)
    try:
        found = np.array(values[:3], float).reshape(3)
        return found if found.any() else None
    except ValueError as error:
        raise InputError(f"{path}: VIEWPOINT is {' '.join(values)!r}, expected x y z and a quaternion") from error
