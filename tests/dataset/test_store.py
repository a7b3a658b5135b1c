import hashlib
from pathlib import Path

import numpy as np
import pytest
import zarr

from clothkit.cloth.topology import SQUARE
from clothkit.dataset.store import Dataset, load, papers_cloths, save
from clothkit.dataset.tasks import tasks_of
from clothkit.runtime.errors import InputError


def make(count: int = 5, seed: int = 0) -> Dataset:
    rng = np.random.default_rng(seed)
    return Dataset(
        vertices=(SQUARE.flat() + rng.normal(scale=0.1, size=(count, 4, 32, 32, 3))).astype(np.float32),
        centre=rng.normal(size=(count, 4, 2)).astype(np.float32),
        manipulation=rng.uniform(-1, 1, (count, 3, 6)).astype(np.float32),
        hands=rng.integers(1, 3, (count, 3)).astype(np.int8),
        length=np.full(count, 3, np.int8),
        split=np.resize(np.array([0, 0, 1, 2, 2], np.int8), count),
        evaluated=np.resize(np.array([True, False, False, True, True]), count),
        **papers_cloths(count)._asdict(),
    )


def digest(folder: Path) -> str:
    found = hashlib.sha256()
    for file in sorted(p for p in folder.rglob("*") if p.is_file()):
        found.update(str(file.relative_to(folder)).encode() + file.read_bytes())
    return found.hexdigest()


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    dataset = make()
    save(tmp_path / "a.zarr", dataset, {"stage": "test"})
    found = load(tmp_path / "a.zarr")
    np.testing.assert_array_equal(found.vertices, dataset.vertices)
    np.testing.assert_array_equal(found.hands, dataset.hands)
    assert found.indices("test").tolist() == [3, 4]
    assert found.indices("train", evaluated=True).tolist() == [0]
    assert len(found.of_split("validation")) == 1


def test_the_same_dataset_gives_the_same_bytes_in_few_files(tmp_path: Path) -> None:
    for name in ("a", "b"):
        save(tmp_path / name, make(), {"stage": "test"})
    assert digest(tmp_path / "a") == digest(tmp_path / "b")
    assert sum(p.is_file() for p in (tmp_path / "a").rglob("*")) < 30


def test_a_store_of_another_grid_is_refused_by_name(tmp_path: Path) -> None:
    save(tmp_path / "a.zarr", make(), {})
    group = zarr.open_group(tmp_path / "a.zarr")
    group.create_array("vertices", shape=(5, 4, 16, 16, 3), dtype="f4", overwrite=True)
    with pytest.raises(InputError, match=r"a\.zarr: vertices has shape \(5, 4, 16, 16, 3\), expected \(5, 4, 32, 32"):
        load(tmp_path / "a.zarr")


def test_a_nan_in_a_stored_state_is_refused_by_name(tmp_path: Path) -> None:
    dataset = make()
    dataset.vertices[3, 2, 5, 6, 1] = np.nan
    save(tmp_path / "a.zarr", dataset, {})
    with pytest.raises(InputError, match=r"a\.zarr: vertices of sequence 3, state 2 is not finite"):
        load(tmp_path / "a.zarr")


def test_states_past_a_sequences_length_may_be_missing(tmp_path: Path) -> None:
    dataset = make()
    dataset.length[1] = 2
    dataset.vertices[1, 3] = dataset.centre[1, 3] = np.nan
    dataset.manipulation[1, 2] = np.nan
    save(tmp_path / "a.zarr", dataset, {})
    assert load(tmp_path / "a.zarr").length[1] == 2


def test_missing_and_broken_stores_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not found"):
        load(tmp_path / "none.zarr")
    save(tmp_path / "a.zarr", make(), {})
    (tmp_path / "a.zarr" / "vertices" / "zarr.json").write_text("{")
    with pytest.raises(InputError, match=r"a\.zarr"):
        load(tmp_path / "a.zarr")


def test_a_sequence_of_three_has_six_tasks() -> None:
    tasks = [(task.start, task.length) for task in tasks_of(7, 3)]
    assert sorted(tasks) == [(0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (2, 1)]
    assert len(tasks_of(7, 1)) == 1
