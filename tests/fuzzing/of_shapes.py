"""Mutations of arrays, point clouds and meshes."""

import io
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.fuzzing.mutations import Random, mutation


def _strays(points: np.ndarray, random: Random) -> np.ndarray:
    return np.concatenate([points.reshape(-1, points.shape[-1]), random.normal(size=(15, points.shape[-1])) * 3000])


_TRANSFORMS: dict[str, Callable[[np.ndarray, Random], np.ndarray]] = {
    "in millimetres": lambda a, _: a * 1000,
    "in kilometres": lambda a, _: a / 1000,
    "moved by 10,000": lambda a, _: a + np.array([10_000, 0, 0]) if a.shape[-1] == 3 else a + 10_000,
    "moved up by 0.5": lambda a, _: a + np.array([0, 0, 0.5]) if a.shape[-1] == 3 else a + 0.5,
    "upright": lambda a, _: a[..., [0, 2, 1]] if a.shape[-1] == 3 else np.swapaxes(a, 0, 1),
    "upside down": lambda a, _: -a,
    "flattened": lambda a, _: a * 0,
    "in a line": lambda a, _: np.repeat(a[..., :1], a.shape[-1], axis=-1),
    "all NaN": lambda a, _: a * np.nan,
    "one NaN": lambda a, r: np.where(np.arange(a.size).reshape(a.shape) == r.integers(a.size), np.nan, a),
    "one infinite": lambda a, r: np.where(np.arange(a.size).reshape(a.shape) == r.integers(a.size), np.inf, a),
    "one at 1e300": lambda a, r: np.where(np.arange(a.size).reshape(a.shape) == r.integers(a.size), 1e300, a),
    "shuffled": lambda a, r: r.permutation(a.reshape(-1, a.shape[-1])).reshape(a.shape),
}
_OF_ARRAYS: dict[str, Callable[[np.ndarray, Random], np.ndarray]] = {
    **_TRANSFORMS,
    "with strays far away": lambda a, r: _strays(a, r) if a.shape[-1] == 3 else a[:-1],
    "raveled": lambda a, _: a.ravel(),
    "transposed": lambda a, _: a.T,
    "one row": lambda a, _: a[:1],
    "no row": lambda a, _: a[:0],
    "of no dimension": lambda a, _: np.array(1.0),
    "of objects": lambda a, _: np.array([None, {}], object),
    "of words": lambda a, _: a.astype(str),
    "complex": lambda a, _: a + 1j,
    "whole": lambda a, _: a.astype(np.int64),
    "as float16": lambda a, _: a.astype(np.float16),
    "true": lambda a, _: a != 0,
    "a record": lambda a, _: np.zeros(3, [("x", "f4"), ("y", "f4")]),
}


def _changed_array(array: np.ndarray, random: Random) -> tuple[np.ndarray, str]:
    how = list(_OF_ARRAYS)[int(random.integers(len(_OF_ARRAYS)))]
    array = array.astype(float) if array.dtype.kind == "b" else array
    with np.errstate(all="ignore"):
        return _OF_ARRAYS[how](np.atleast_2d(array), random), how


@mutation("npy")
def _array(path: Path, random: Random) -> str:
    array, how = _changed_array(np.load(path), random)
    np.save(path, array, allow_pickle=True)
    return how


@mutation("npy", "npz")
def _header_lies(path: Path, random: Random) -> str:
    arrays = {"": path.read_bytes()}
    if path.suffix == ".npz":
        with zipfile.ZipFile(path) as archive:
            arrays = {name: archive.read(name) for name in archive.namelist()}
    name = list(arrays)[int(random.integers(len(arrays)))]
    lie = [b"(0,", b"(9,", b"(-1,", b"(999999999,", b"(1e9,", b"None"][int(random.integers(6))]
    arrays[name] = re.sub(rb"\(\d+,", lie, arrays[name], count=1)
    if path.suffix == ".npz":
        with zipfile.ZipFile(path, "w") as archive:
            for member, content in arrays.items():
                archive.writestr(member, content)
    else:
        path.write_bytes(arrays[name])
    return f"{name} says that it is {lie.decode()}.."


@mutation("npz")
def _member_changed(path: Path, random: Random) -> str:
    with np.load(path) as stored:
        arrays = dict(stored)
    name = list(arrays)[int(random.integers(len(arrays)))]
    if random.random() < 0.25:
        arrays["renamed"], how = arrays.pop(name), "renamed"
    else:
        arrays[name], how = _changed_array(arrays[name], random)
    np.savez(path, allow_pickle=True, **arrays)
    return f"{name} {how}"


_LIES = ("0", "-1", "1", "7", "1000000000000", "4294967296", "nan", "x", "")


@mutation("text")
def _number_in_header(path: Path, random: Random) -> str | None:
    content = path.read_bytes()
    found = list(re.finditer(rb"(?<=[ \n])-?\d+(\.\d+)?(?=\s)", content[:500]))
    if not found:
        return None
    number, lie = found[int(random.integers(len(found)))], _LIES[int(random.integers(len(_LIES)))]
    path.write_bytes(content[: number.start()] + lie.encode() + content[number.end() :])
    return f"{number[0].decode()} at byte {number.start()} made {lie!r}"


@mutation("text")
def _line(path: Path, random: Random) -> str | None:
    lines = path.read_bytes().splitlines(keepends=True)
    end = len(lines) if random.random() < 0.5 else min(12, len(lines))
    place, how = int(random.integers(end)), ("missing", "twice", "of noise")[int(random.integers(3))]
    lines[place : place + 1] = {"missing": [], "twice": [lines[place]] * 2, "of noise": [b"noise 1 nan x\n"]}[how]
    path.write_bytes(b"".join(lines))
    return f"line {place} {how}"


@mutation("text")
def _positions(path: Path, random: Random) -> str | None:
    """Of text alone: lines of vertices are those with three numbers or more, after `v` in OBJ."""
    try:
        lines = path.read_bytes().decode("ascii").splitlines()
    except UnicodeDecodeError:
        return None
    prefix = "v " if path.suffix == ".obj" else ""
    rows = [k for k, line in enumerate(lines) if re.match(rf"{prefix}-?[\d.e+-]+ -?[\d.e+-]+ -?[\d.e+-]+", line)]
    points = np.loadtxt(io.StringIO("\n".join(lines[k].removeprefix(prefix) for k in rows)), usecols=(0, 1, 2))
    how = list(_TRANSFORMS)[int(random.integers(len(_TRANSFORMS)))]
    with np.errstate(all="ignore"):
        changed = _TRANSFORMS[how](points, random)
    for k, point in zip(rows, changed.tolist(), strict=True):
        rest = lines[k].removeprefix(prefix).split()[3:]
        lines[k] = " ".join([prefix.strip(), *map(str, point), *rest]).strip()
    path.write_text("\n".join(lines) + "\n")
    return how
