"""Point clouds in PCD files (Point Cloud Library, version .7), ASCII and binary, as arrays by field."""

from pathlib import Path

import numpy as np

from clothkit.errors import InputError
from clothkit.observation.states import PointCloud

_KINDS = {"F": "f", "U": "u", "I": "i"}
_NEEDED = ("FIELDS", "SIZE", "TYPE", "POINTS", "DATA")


def read_pcd(path: Path) -> PointCloud:
    """The cloud in a PCD file, with its viewpoint and, where it has `rgb` or `rgba`, its colours.

    A viewpoint at the origin is not taken for one: writers put it there, in whatever frame, when they know none.
    Raises InputError when the header is not one of a PCD file, the data are compressed or end too early, or x, y and z
    are not among the fields.
    """
    content = path.read_bytes()
    header, begin = _header(path, content)
    dtype = _dtype(path, header)
    points = _number(path, header, "POINTS")
    encoding = header["DATA"][0].lower()
    if encoding == "ascii":
        table = _ascii(path, content[begin:], dtype, points)
    elif encoding == "binary":
        found = (len(content) - begin) // dtype.itemsize
        if found < points:
            raise InputError(f"{path}: ends after {found} points, its header says {points}")
        table = np.frombuffer(content, dtype, count=points, offset=begin)
    else:
        raise InputError(f"{path}: DATA is {encoding}, expected ascii or binary; save it uncompressed")
    # Cameras write all kinds of NaN.
    with np.errstate(invalid="ignore"):
        xyz = np.stack([table[axis].astype(float) for axis in "xyz"], axis=-1)
    return PointCloud(xyz, colours=_colours(table), viewpoint=_viewpoint(path, header))


def _header(path: Path, content: bytes) -> tuple[dict[str, list[str]], int]:
    """The header's entries, and where the data begin."""
    header: dict[str, list[str]] = {}
    position = 0
    while "DATA" not in header:
        end = content.find(b"\n", position)
        line = content[position:end].decode("ascii", "replace").split() if end >= 0 else None
        if line is None or len(header) > 20:
            raise InputError(f"{path}: is no PCD file, its header has no line DATA")
        if line and not line[0].startswith("#"):
            header[line[0].upper()] = line[1:]
        position = end + 1
    missing = [name for name in _NEEDED if not header.get(name)]
    if missing:
        raise InputError(f"{path}: is no PCD file, its header has no line {missing[0]}")
    return header, position


def _number(path: Path, header: dict[str, list[str]], name: str) -> int:
    try:
        number = int(header[name][0])
        if number < 0:
            raise ValueError
        return number
    except ValueError as error:
        raise InputError(f"{path}: {name} is {header[name][0]!r} in its header, expected a whole number") from error


def _dtype(path: Path, header: dict[str, list[str]]) -> np.dtype:
    """How a point is laid out. Fields called _ are padding, of which there may be several."""
    fields, sizes, kinds = header["FIELDS"], header["SIZE"], header["TYPE"]
    counts = header.get("COUNT", ["1"] * len(fields))
    if not len(fields) == len(sizes) == len(kinds) == len(counts):
        raise InputError(f"{path}: FIELDS, SIZE, TYPE and COUNT of its header differ in length")
    missing = [axis for axis in "xyz" if fields.count(axis) != 1]
    if missing:
        raise InputError(f"{path}: has no field {missing[0]}, its fields are {' '.join(fields)}")
    layout = []
    for k, (field, size, kind, count) in enumerate(zip(fields, sizes, kinds, counts, strict=True)):
        try:
            one = np.dtype(f"<{_KINDS[kind]}{size}")
            if field in ("x", "y", "z") and count != "1":
                raise ValueError
            layout.append((f"_{k}" if field == "_" else field, one, *([(int(count),)] if count != "1" else [])))
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path}: field {field} has type {kind}, size {size}, count {count}: unknown") from error
    return np.dtype(layout)


def _ascii(path: Path, text: bytes, dtype: np.dtype, points: int) -> np.ndarray:
    lines = [line.split() for line in text.decode("ascii", "replace").splitlines() if line.strip()]
    if len(lines) < points:
        raise InputError(f"{path}: ends after {len(lines)} points, its header says {points}")
    table = np.zeros(points, dtype)
    assert dtype.names is not None
    width = sum(int(np.prod(dtype[name].shape)) for name in dtype.names)
    for row, line in enumerate(lines[:points]):
        try:
            if len(line) != width:
                raise ValueError
            position = 0
            for name in dtype.names:
                count = int(np.prod(dtype[name].shape))
                values = np.array(line[position : position + count], float)
                table[name][row] = values if dtype[name].shape else values[0]
                position += count
        except (ValueError, OverflowError) as error:
            raise InputError(f"{path}: point {row} is {' '.join(line)[:60]!r}, expected {width} numbers") from error
    return table


def _colours(table: np.ndarray) -> np.ndarray | None:
    """Red, green and blue, which PCL packs into the bytes of a float or of a whole number."""
    name = next((name for name in ("rgb", "rgba") if name in (table.dtype.names or ())), None)
    if name is None or table.dtype[name].itemsize != 4:
        return None
    packed = np.ascontiguousarray(table[name]).view(np.uint32)
    return np.stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255], axis=-1).astype(np.uint8)


def _viewpoint(path: Path, header: dict[str, list[str]]) -> np.ndarray | None:
    """Where the camera was; None for the origin."""
    values = header.get("VIEWPOINT", ["0"] * 7)
    try:
        found = np.array(values[:3], float).reshape(3)
        return found if found.any() else None
    except ValueError as error:
        raise InputError(f"{path}: VIEWPOINT is {' '.join(values)!r}, expected x y z and a quaternion") from error
