"""Damaged stores of meshes: each fault is one sentence that names the store; what is healthy is read."""

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from clothkit.dataset.store import Dataset, load, load_splits, save
from clothkit.dataset.zarr_store import check_shards, open_node
from clothkit.runtime.errors import InputError
from tests.dataset.test_store import make

STATED = {"train": 2, "validation": 1, "test": 2, "evaluated": 1}


def prefixed() -> Dataset:
    """Splits and flags as `regularise` leaves them with STATED."""
    return dataclasses.replace(make(), evaluated=np.array([True, False, False, True, False]))


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("healthy") / "meshes.zarr"
    save(path, prefixed(), {"stage": "regularise", "params": STATED})
    return path


@pytest.fixture
def store(healthy: Path, tmp_path: Path) -> Path:
    return shutil.copytree(healthy, tmp_path / "meshes.zarr")


def metadata(name: str, change: Callable[[dict[str, Any]], None]) -> Callable[[Path], None]:
    def damage(store: Path) -> None:
        path = store / name / "zarr.json"
        stored = json.loads(path.read_text())
        change(stored)
        path.write_text(json.dumps(stored))

    return damage


def rewritten(name: str, data: np.ndarray, *dimensions: str) -> Callable[[Path], None]:
    def damage(store: Path) -> None:
        shutil.rmtree(store / name)
        names = dimensions or None
        zarr.open_group(store).create_array(name, data=data, dimension_names=names)

    return damage


def cut(store: Path) -> None:
    (path,) = (file for file in (store / "vertices/c").rglob("*") if file.is_file())
    path.write_bytes(path.read_bytes()[:1000])


def flip_index(store: Path) -> None:
    (path,) = (file for file in (store / "hands/c").rglob("*") if file.is_file())
    content = bytearray(path.read_bytes())
    content[-12] ^= 1
    path.write_bytes(content)


def group_instead(store: Path) -> None:
    shutil.rmtree(store / "centre")
    zarr.open_group(store).create_group("centre")


def drop(name: str) -> Callable[[Path], None]:
    return lambda store: shutil.rmtree(store / name)


def writing(name: str, text: str) -> Callable[[Path], Any]:
    return lambda store: (store / name).write_text(text)


FAULTS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "no array": (drop("hands"), "has no array hands"),
    "shards missing": (drop("vertices/c"), "array vertices: chunk c/0/0/0/0/0 is missing, expected all 1"),
    "hands missing": (drop("hands/c"), "array hands: chunk c/0/0 is missing"),
    "split missing": (drop("split/c"), "array split: chunk c/0 is missing"),
    "flags missing": (drop("evaluated/c"), "array evaluated: chunk c/0 is missing"),
    "empty folder": (lambda store: (store / "split/c/0").unlink(), "array split: chunk c/0 is missing"),
    "shard cut": (cut, "array vertices: can't be read, a chunk is damaged"),
    "index damaged": (flip_index, "array hands: can't be read, a chunk is damaged"),
    "group": (group_instead, "centre is a group, expected an array"),
    "no JSON": (writing("length/zarr.json", "{"), "can't be read as a zarr store"),
    "no object": (writing("length/zarr.json", "[]"), "can't be read as a zarr store"),
    "root no JSON": (writing("zarr.json", "\x00"), "can't be read as a zarr store"),
    "root is an array": (
        lambda store: shutil.copy(store / "length/zarr.json", store / "zarr.json"),
        "is one array, expected a group",
    ),
    "huge": (
        metadata("vertices", lambda stored: stored.update(shape=[10**9, 4, 32, 32, 3])),
        r"vertices has shape \(1000000000, 4, 32, 32, 3\), expected \(5, 4, 32, 32, 3\)",
    ),
    "another kind": (metadata("centre", lambda stored: stored.update(data_type="float64")), "centre holds float64"),
    "no kind": (metadata("centre", lambda stored: stored.update(data_type="float31")), "can't be read as a zarr"),
    "no codec": (metadata("centre", lambda stored: stored.update(codecs=[])), "can't be read"),
    "dimensions": (
        metadata("centre", lambda stored: stored.update(dimension_names=["sequence", "step", "xy"])),
        r"centre has dimensions .* expected \(sequence, state, xy\)",
    ),
    "fewer rows": (
        rewritten("length", np.full(3, 3, np.int8), "sequence"),
        r"length has shape \(3,\), expected \(5,\)",
    ),
    "length 9": (rewritten("length", np.full(5, 9, np.int8), "sequence"), r"length has values outside 1\.\.3"),
    "split 7": (rewritten("split", np.full(5, 7, np.int8), "sequence"), r"split has values outside 0\.\.2"),
    "five hands": (
        rewritten("hands", np.full((5, 3), 5, np.int8), "sequence", "step"),
        "hands of sequence 0, step 0 is not 1 or 2",
    ),
    "millimetres": (
        rewritten("centre", np.full((5, 4, 2), 4e5, np.float32), "sequence", "state", "xy"),
        "centre of sequence 0, state 0 is beyond 1000",
    ),
    "cloth in metres": (
        rewritten("cloth", np.full((5, 3), 40, np.float32), "sequence", "measure"),
        r"cloth of sequence 0, measure 0 is not above 0 and at most 1\.4",
    ),
    "start 3": (rewritten("start", np.full(5, 3, np.int8), "sequence"), r"start of sequence 0.* is not from 0 to 2"),
}


@pytest.mark.parametrize(("damage", "sentence"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_one_sentence(store: Path, damage: Callable[[Path], Any], sentence: str) -> None:
    load(store)
    damage(store)
    with pytest.raises(InputError, match=sentence) as told:
        load(store)
    assert str(told.value).startswith(str(store))
    assert len(str(told.value).splitlines()) == 1


def test_no_file_of_a_store_can_be_lost_unseen(healthy: Path, tmp_path: Path) -> None:
    files = [path.relative_to(healthy) for path in sorted(healthy.rglob("*")) if path.is_file()]
    assert len(files) == 1 + 2 * 10
    for number, file in enumerate(files):
        store = shutil.copytree(healthy, tmp_path / str(number))
        (store / file).unlink()
        for folder in sorted(store.rglob("c"), reverse=True):
            if not any(path.is_file() for path in folder.rglob("*")):
                shutil.rmtree(folder)
        with pytest.raises(InputError, match=str(store)):
            load(store)


def test_what_is_no_folder_or_not_there_is_told(tmp_path: Path) -> None:
    (tmp_path / "file.zarr").write_text("text")
    (tmp_path / "empty.zarr").mkdir()
    for name, sentence in (
        ("none", "not found"),
        ("file", "is a file, expected a zarr"),
        ("empty", "can't be read"),
    ):
        with pytest.raises(InputError, match=rf"{name}\.zarr: {sentence}"):
            load(tmp_path / f"{name}.zarr")


@pytest.mark.parametrize("missing", ["split", "evaluated", "centre", "manipulation"])
def test_all_zeros_are_not_taken_for_missing(tmp_path: Path, missing: str) -> None:
    """No flag set, all of the first split, cloths that never leave the origin: chunks of zeros are there, too."""
    dataset = make()
    getattr(dataset, missing)[:] = 0
    save(tmp_path / "a.zarr", dataset, {})
    found = load(tmp_path / "a.zarr")
    assert not getattr(found, missing).any()
    np.testing.assert_array_equal(found.vertices, dataset.vertices)


def test_sequences_of_one_manipulation(tmp_path: Path) -> None:
    dataset = make()
    dataset.length[:] = 1
    dataset.vertices[:, 2:] = dataset.centre[:, 2:] = dataset.manipulation[:, 1:] = np.nan
    dataset.hands[:, 1:] = 0
    save(tmp_path / "a.zarr", dataset, {})
    assert load(tmp_path / "a.zarr").length.tolist() == [1] * 5
    assert [values.tolist() for values in load_splits(tmp_path / "a.zarr")] == [[0, 0, 1, 2, 2], [1] * 5]


def test_shards_of_zeros_alone_have_a_file_like_others(tmp_path: Path) -> None:
    """More sequences than a shard holds, the flags of the second one unset."""
    count = 1030
    few = make(1)
    many = few.take(np.zeros(count, int))
    flags = np.arange(count) < 3
    save(tmp_path / "a.zarr", dataclasses.replace(many, evaluated=flags, split=flags.astype(np.int8)), {})
    np.testing.assert_array_equal(load(tmp_path / "a.zarr").evaluated, flags)
    for name in ("evaluated", "length"):
        (tmp_path / f"a.zarr/{name}/c/1").rename(tmp_path / name)
        with pytest.raises(InputError, match=f"array {name}: chunk c/1 is missing, expected all 2 of them"):
            load(tmp_path / "a.zarr")
        (tmp_path / name).rename(tmp_path / f"a.zarr/{name}/c/1")


def test_no_bit_of_a_shard_can_flip_unseen(healthy: Path, tmp_path: Path) -> None:
    """Chunks have checksums of their own, and so has the index that says where they are."""
    rng, original = np.random.default_rng(0), load(healthy)
    shards = [path.relative_to(healthy) for path in sorted(healthy.rglob("c/**/*")) if path.is_file()]
    for number in range(60):
        shard = shards[number % len(shards)]
        store = shutil.copytree(healthy, tmp_path / str(number))
        content = bytearray((store / shard).read_bytes())
        content[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
        (store / shard).write_bytes(content)
        try:
            found = load(store)
        except InputError:
            continue
        # A flip that no checksum covers (a flag of the frame's header, say) leaves every value as it was.
        for field in dataclasses.fields(original):
            np.testing.assert_array_equal(getattr(found, field.name), getattr(original, field.name))


def test_other_zarr_arrays_of_many_chunks(tmp_path: Path) -> None:
    points = zarr.create_array(tmp_path / "points.zarr", shape=(10, 3), chunks=(4, 3), dtype="f8")
    points[:] = np.arange(30).reshape(10, 3)
    check_shards(points, "points")
    (tmp_path / "points.zarr/c/1/0").unlink()
    with pytest.raises(InputError, match="points: chunk c/1/0 is missing, expected all 3 of them"):
        check_shards(points, "points")
    old = zarr.create_array(tmp_path / "old.zarr", shape=(10, 3), chunks=(4, 3), dtype="f8", zarr_format=2)
    old[:] = 1
    node = open_node(tmp_path / "old.zarr")
    assert isinstance(node, zarr.Array)
    check_shards(node, "old")
