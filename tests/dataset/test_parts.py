"""Stores that are written a shard at a time: the bytes of those written at once, in memory that does not grow."""

import dataclasses
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
import zarr

from clothkit.dataset import regularise as regularising
from clothkit.dataset import store
from clothkit.dataset.augment import AugmentConfig, augment, augmented
from clothkit.dataset.regularise import RegulariseConfig, regularised
from clothkit.dataset.store import Dataset, Parts, in_parts, load, load_parts, save, save_parts
from clothkit.dataset.zarr_store import consolidate, create_array, create_group
from clothkit.runtime.errors import InputError

from .test_regularise import write_raw
from .test_store import digest, make

ABOUT = {"stage": "test"}
VARIED = AugmentConfig(variants=3, null_share=0.5, seed=4)


@pytest.fixture(autouse=True)
def small_shards(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (store, regularising):
        monkeypatch.setattr(module, "SHARD", 16)


def many(count: int) -> Dataset:
    """Different sequences, two of three in the training split, some of them short."""
    found = dataclasses.replace(
        make(count), split=np.arange(count, dtype=np.int8) % 3 // 2, evaluated=np.arange(count) % 5 == 0
    )
    found.length[::7] = 1
    found.vertices[::7, 2:] = found.centre[::7, 2:] = found.manipulation[::7, 1:] = np.nan
    return found


def write_at_once(path: Path, dataset: Dataset) -> None:
    """As the stages did before: each array as a whole."""
    group = create_group(path, {**ABOUT, "splits": list(store.SPLITS), "labels": store.labels_of(store._ARRAYS)})
    for name, declared in store._ARRAYS.items():
        values = getattr(dataset, name).astype(declared.dtype)
        rest = values.shape[1:]
        create_array(group, name, declared, values, chunk=(16, *rest), shard=(16, *rest))
    consolidate(group)


def moved_raw(folder: Path, count: int) -> Path:
    """Raw artifacts of different states, in files of seven sequences, the last ones first."""
    raw = write_raw(folder, count)
    whole = pd.read_parquet(raw / "states/0.parquet")
    (raw / "states/0.parquet").unlink()
    moves = pd.read_parquet(raw / "manipulations.parquet")
    moves.assign(dy=moves["dy"] / count).to_parquet(raw / "manipulations.parquet")
    rng = np.random.default_rng(0)
    whole["vertices"] = [own + rng.normal(scale=1e-4, size=own.shape).astype(np.float32) for own in whole["vertices"]]
    for number, first in enumerate(reversed(range(0, count, 7))):
        part = whole[whole["sequence"].between(first, first + 6)]
        part.sample(frac=1, random_state=0).to_parquet(raw / f"states/{number}.parquet")
    return raw


def test_parts_have_the_bytes_of_arrays_written_whole(tmp_path: Path) -> None:
    for count in (16, 37):
        write_at_once(tmp_path / f"whole_{count}", many(count))
        save(tmp_path / f"parts_{count}", many(count), ABOUT)
        assert digest(tmp_path / f"parts_{count}") == digest(tmp_path / f"whole_{count}")


def test_the_stages_write_what_they_wrote_with_all_in_memory(tmp_path: Path) -> None:
    raw, settings = moved_raw(tmp_path / "raw", 41), RegulariseConfig(train=30, validation=5, test=5, evaluated=2)
    parts = regularised(raw, settings)
    assert parts.sequences == 40
    found = list(parts.each)
    assert [len(part) for part in found] == [16, 16, 8]
    save_parts(tmp_path / "meshes", Parts(40, found), ABOUT)
    # What comes first is what the files have last.
    states = pd.concat(pd.read_parquet(file) for file in sorted((raw / "states").iterdir()))
    states = states.set_index(["sequence", "state"])["vertices"]
    meshes = load(tmp_path / "meshes")
    for sequence, state in ((0, 0), (20, 3), (39, 1)):
        own = np.reshape(states[sequence, state], (32, 32, 3)) * np.float32(3.5)
        centre = np.append(meshes.centre[sequence, state], 0)
        np.testing.assert_allclose(meshes.vertices[sequence, state] + centre, own, atol=1e-5)
    save_parts(tmp_path / "augmented", augmented(tmp_path / "meshes", VARIED), ABOUT)
    write_at_once(tmp_path / "whole", augment(meshes.of_split("train"), VARIED))
    assert digest(tmp_path / "augmented") == digest(tmp_path / "whole")


def test_chosen_sequences_are_read_in_parts_and_checked(tmp_path: Path) -> None:
    whole = many(50)
    whole.vertices[40, 1, 2, 3, 0] = 2000.0
    save(tmp_path / "a.zarr", whole, ABOUT)
    rows = np.array([0, 0, 3, 17, *range(20, 39), 49])
    found = list(load_parts(tmp_path / "a.zarr", rows))
    assert [len(part) for part in found] == [16, 8]
    for field in dataclasses.fields(Dataset):
        read = np.concatenate([getattr(part, field.name) for part in found])
        np.testing.assert_array_equal(read, getattr(whole, field.name)[rows])
    with pytest.raises(InputError, match=r"a\.zarr: vertices of sequence 40, state 1 is beyond 1000"):
        list(load_parts(tmp_path / "a.zarr", np.arange(20, 50)))
    short = in_parts(whole)._replace(sequences=60)
    with pytest.raises(ValueError, match="parts have 50 sequences, expected 60"):
        save_parts(tmp_path / "b.zarr", short, ABOUT)


def peak(work: Callable[[], None]) -> tuple[int, int]:
    """The most bytes that NumPy and Python held at a time, and those that Arrow did."""
    before, own = pa.default_memory_pool(), pa.proxy_memory_pool(pa.default_memory_pool())
    pa.set_memory_pool(own)
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1], own.max_memory()
    finally:
        tracemalloc.stop()
        pa.set_memory_pool(before)


def peaks(folder: Path, count: int) -> dict[str, int]:
    """The peaks of both stages with so many sequences, in bytes."""
    raw, settings = moved_raw(folder / "raw", count), RegulariseConfig(train=count - 4, validation=2, test=2)
    meshes = folder / "meshes"
    regularise, files = peak(lambda: save_parts(meshes, regularised(raw, settings), ABOUT))
    augment, _ = peak(lambda: save_parts(folder / "augmented", augmented(meshes, VARIED), ABOUT))
    return {"regularise": regularise, "its files": files, "augment": augment}


def test_memory_does_not_grow_with_the_number_of_sequences(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Where a mesh lies needs no memory, but most of the time.
    monkeypatch.setattr(regularising, "centred", lambda mesh: (mesh, mesh[0, 0, :2]))
    # The first run imports and fills caches.
    _, few, many_more = (peaks(tmp_path / str(count), count) for count in (8, 36, 96))
    mesh_bytes = 4 * 32 * 32 * 3 * 4
    for name, found in many_more.items():
        assert found > 7 * mesh_bytes, name
        # All meshes of the larger one take 60 times `mesh_bytes` more than those of the smaller one.
        assert found - few[name] < 10 * mesh_bytes, name


def test_a_fault_in_another_split_is_told_before_training_sequences_are_varied(tmp_path: Path) -> None:
    path = tmp_path / "meshes.zarr"
    save(path, many(40), ABOUT)
    zarr.open_group(path)["vertices"][38, 1, 3, 4, 0] = float("nan")  # type: ignore[index]
    assert many(40).split[38] != 0
    with pytest.raises(InputError, match="vertices of sequence 38, state 1 is not finite"):
        augmented(path, VARIED)
