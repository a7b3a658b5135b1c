"""PCD files as PCL and others write them."""

import struct
from collections.abc import Mapping
from pathlib import Path

import lzf
import numpy as np

_TYPES = {"f": "F", "u": "U", "i": "I"}


def packed(colours: np.ndarray) -> np.ndarray:
    """Colours [n, 3] as PCL packs them into floats."""
    red, green, blue = colours.astype(np.uint32).T
    return (red << 16 | green << 8 | blue).view(np.float32)


def literal(raw: bytes) -> bytes:
    """LZF that compresses nothing: runs of up to 32 bytes, as they are."""
    return b"".join(bytes([len(run) - 1]) + run for run in (raw[k : k + 32] for k in range(0, len(raw), 32)))


def written(
    path: Path,
    columns: Mapping[str, np.ndarray],
    data: str,
    *,
    header: Mapping[str, str] | None = None,
    newline: str = "\n",
    literally: bool = False,
) -> Path:
    """A cloud of named columns [n] or [n, count]; `header` replaces entries, or drops them where it has nothing."""
    arrays = [np.asarray(column).reshape(len(column), -1) for column in columns.values()]
    points = len(arrays[0])
    entries = {
        "VERSION": "0.7",
        "FIELDS": " ".join(columns),
        "SIZE": " ".join(str(array.itemsize) for array in arrays),
        "TYPE": " ".join(_TYPES[array.dtype.kind] for array in arrays),
        "COUNT": " ".join(str(array.shape[1]) for array in arrays),
        "WIDTH": str(points),
        "HEIGHT": "1",
        "VIEWPOINT": "0.1 0.2 0.9 1 0 0 0",
        "POINTS": str(points),
        "DATA": data,
    }
    entries.update(header or {})
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        *(f"{name} {value}" for name, value in entries.items() if value),
    ]
    if data == "ascii":
        rows = zip(*(array.tolist() for array in arrays), strict=True)
        body = "".join(" ".join(repr(number) for cell in row for number in cell) + newline for row in rows).encode()
    elif data == "binary":
        body = b"".join(array[row].tobytes() for row in range(points) for array in arrays)
    else:
        raw = b"".join(array.tobytes() for array in arrays)
        squeezed = literal(raw) if literally else lzf.compress(raw, 2 * len(raw) + 64)
        body = struct.pack("<II", len(squeezed), len(raw)) + squeezed
    path.write_bytes((newline.join(lines) + newline).encode() + body)
    return path


def written_pcd(path: Path, points: np.ndarray, data: str, *, header: Mapping[str, str] | None = None) -> Path:
    """A cloud [n, 3] as PCL writes it, with padding and one packed colour."""
    colours = packed(np.tile([10, 200, 30], (len(points), 1)))
    x, y, z = points.astype(np.float32).T
    padding = np.zeros((len(points), 4), np.uint8)
    return written(path, {"x": x, "y": y, "z": z, "_": padding, "rgb": colours}, data, header=header)
