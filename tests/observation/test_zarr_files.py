"""Damaged zarr files as observations: each fault is one sentence that names the file."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from clothkit.cloth import voxels
from clothkit.cloth.topology import SQUARE
from clothkit.dataset.store import save
from clothkit.observation.files import read
from clothkit.observation.states import MeshState, PointCloud, VoxelState
from clothkit.runtime.errors import InputError
from tests.dataset.test_store import make


def meshes(folder: Path) -> Path:
    save(folder / "meshes.zarr", make(), {})
    return folder / "meshes.zarr"


def array(folder: Path, data: np.ndarray, chunks: tuple[int, ...]) -> Path:
    made = zarr.create_array(folder / "own.zarr", shape=data.shape, dtype=data.dtype, chunks=chunks)
    made[:] = data
    return folder / "own.zarr"


def edit(path: Path, **fields: Any) -> None:
    path.write_text(json.dumps({**json.loads(path.read_text()), **fields}))


def first_chunk(store: Path) -> Path:
    return next(path for path in sorted((store / "c").rglob("*")) if path.is_file())


def damaged(folder: Path) -> Path:
    store = array(folder, SQUARE.flat(), (32, 32, 3))
    first_chunk(store).write_bytes(b"\x28\xb5\x2f\xfd chunk")
    return store


def missing(folder: Path) -> Path:
    store = array(folder, SQUARE.flat(), (16, 32, 3))
    first_chunk(store).unlink()
    return store


def huge(folder: Path) -> Path:
    store = array(folder, np.ones((8, 3)), (4, 3))
    edit(store / "zarr.json", shape=[10**9, 3])
    return store


def many(folder: Path) -> Path:
    store = array(folder, np.ones((8, 3)), (4, 3))
    edit(store / "zarr.json", shape=[10**9, 10**9])
    return store


def of_sequence(change: Callable[[Path], Any]) -> Callable[[Path], str]:
    def make_one(folder: Path) -> str:
        store = meshes(folder)
        change(store)
        return f"{store}:1/2"

    return make_one


FAULTS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "damaged": (damaged, "can't be read, a chunk is damaged"),
    "missing": (missing, "chunk c/0/0/0 is missing, expected all 2 of them"),
    "huge": (huge, "chunk c/2/0 is missing, expected all 250000000 of them"),
    "another shape": (many, r"has shape \[1000000000, 1000000000\], expected \[32, 32, 3\]"),
    "shard missing": (
        of_sequence(lambda store: first_chunk(store / "vertices").unlink()),
        "array vertices: chunk c/0/0/0/0/0 is missing",
    ),
    "shard damaged": (
        of_sequence(lambda store: first_chunk(store / "centre").write_bytes(bytes(2000))),
        "array centre: can't be read, a chunk is damaged",
    ),
    "vertices huge": (
        of_sequence(lambda store: edit(store / "vertices/zarr.json", shape=[10**9, 4, 32, 32, 3])),
        "has shape",
    ),
    "no metadata": (of_sequence(lambda store: (store / "centre/zarr.json").write_text("")), "can't be read as"),
}


@pytest.mark.parametrize(("make_one", "sentence"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_one_sentence(tmp_path: Path, make_one: Callable[[Path], Any], sentence: str) -> None:
    source = make_one(tmp_path)
    with pytest.raises(InputError, match=sentence) as told:
        read(source)
    assert str(told.value).startswith(str(tmp_path))
    assert len(str(told.value).splitlines()) == 1


def test_what_is_healthy_is_read(tmp_path: Path) -> None:
    assert isinstance(read(f"{meshes(tmp_path)}:1/2"), MeshState)
    assert isinstance(read(array(tmp_path / "mesh", SQUARE.flat(), (16, 16, 3))), MeshState)
    assert isinstance(read(array(tmp_path / "points", np.ones((10, 3)), (4, 3))), PointCloud)
    seen = np.asarray(voxels.observe(SQUARE.flat()))
    store = array(tmp_path / "voxels", seen, (8, 8, 4))
    # Zarr writes no chunk of empty voxels.
    assert 0 < sum(path.is_file() for path in (store / "c").rglob("*")) < 4**3
    found = read(store)
    assert isinstance(found, VoxelState)
    np.testing.assert_array_equal(found.voxels, seen)
