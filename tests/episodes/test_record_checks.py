"""Recorded sessions with each fault, one by one, in memory and in what zarr leaves of them."""

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from clothkit.dataset.tasks import tasks_of
from clothkit.episodes.record import (
    Sessions,
    Sizes,
    load,
    load_members,
    load_piece,
    load_tasks,
    record,
    save,
    save_piece,
    tasks_of_dataset,
)
from clothkit.runtime.errors import InputError
from tests.dataset.test_store import make

TASKS = [*tasks_of(0, 2), *tasks_of(3, 3)]


def sessions(*, voxels: bool = False, nets: int = 1) -> Sessions:
    """Sessions of which nothing is known but where they were, a null that was cancelled among them."""
    dataset = make()
    shape = (32, 32, 16) if voxels else (32, 32, 3)
    sizes = Sizes(shape, not voxels, candidate=2, net=nets, iteration=2)
    found = record(tasks_of_dataset(dataset, TASKS, "test"), [], sizes)
    for row, (sequence, start, length) in enumerate(TASKS):
        for step in range(length):
            found.state[row, step + 1] = dataset.vertices[sequence, start + step + 1]
            found.centre[row, step + 1] = dataset.centre[sequence, start + step + 1]
            found.estimate[row, step], found.plan[row, step, : length - step] = 0.5, 0.3
            found.loss[row, step], found.common[row, step], found.relative[row, step] = 0.1, 3, 0
    found.null[8, 1] = found.cancelled[8, 1] = True
    found.error_otherwise[8, 1] = 0.2
    return found


FAULTS: dict[str, tuple[Callable[[Sessions], Any], str]] = {
    "start": (lambda of: of.start.__setitem__(2, 5), "start of session 2: expected 0 to 2"),
    "length": (lambda of: of.length.__setitem__(2, 0), "length of session 2: expected 1 to 3"),
    "end": (lambda of: of.length.__setitem__(1, 3), "length of session 1: expected sessions that end at state 3"),
    "twice": (lambda of: of.sequence.__setitem__(4, -1), "sequence of session 4: expected 0 to"),
    "again": (lambda of: of.start.__setitem__(1, 0), "sequence of session 1: expected each task once"),
    "goal": (lambda of: of.goal.__setitem__((1, 0, 0, 0), np.nan), "goal of session 1: expected finite values"),
    "state": (lambda of: of.state.__setitem__((8, 2, 0, 0, 0), np.inf), "state of session 8, step 2: expected finite"),
    "past the end": (lambda of: of.state.__setitem__((0, 2), 0), "state of session 0, step 2: expected finite values"),
    "estimate": (lambda of: of.estimate.__setitem__((8, 2), np.nan), "estimate of session 8, step 2"),
    "plan": (lambda of: of.plan.__setitem__((8, 0, 1, 5), np.nan), "plan of session 8, step 0"),
    "plan past": (lambda of: of.plan.__setitem__((8, 1, 2), 0), "plan of session 8, step 1"),
    "loss": (lambda of: of.loss.__setitem__((8, 0), np.nan), "loss of session 8, step 0"),
    "label": (lambda of: of.common.__setitem__((8, 0), 8), "common of session 8, step 0: expected labels 0 to 7"),
    "label past": (lambda of: of.relative.__setitem__((0, 1), 0), "relative of session 0, step 1: expected labels"),
    "null": (lambda of: of.null.__setitem__((0, 2), True), "null of session 0, step 2: expected none past"),
    "cancelled": (lambda of: of.cancelled.__setitem__((8, 0), True), "null of session 8, step 0: expected every canc"),
    "otherwise": (
        lambda of: of.error_otherwise.__setitem__((8, 0), 1),
        "cancelled of session 8, step 0: expected",
    ),
}


@pytest.mark.parametrize(("damage", "sentence"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_one_sentence(tmp_path: Path, damage: Callable[[Sessions], Any], sentence: str) -> None:
    of = sessions()
    damage(of)
    save(tmp_path / "s.zarr", [of], {})
    with pytest.raises(InputError, match=sentence) as told:
        load(tmp_path / "s.zarr")
    assert str(told.value).startswith(f"{tmp_path}/s.zarr: ")
    assert len(str(told.value).splitlines()) == 1


@pytest.mark.parametrize("voxels", [False, True])
def test_healthy_sessions_come_back_whole_and_one_by_one(tmp_path: Path, *, voxels: bool) -> None:
    of = sessions(voxels=voxels)
    save(tmp_path / "s.zarr", [of], {})
    back, one = load(tmp_path / "s.zarr"), load(tmp_path / "s.zarr", slice(8, 9))
    for name, values in vars(of).items():
        np.testing.assert_array_equal(getattr(back, name), values)
        np.testing.assert_array_equal(getattr(one, name), values[8:9])
    assert load_tasks(tmp_path / "s.zarr") == [("test", *task) for task in TASKS]


@pytest.mark.parametrize("nets", [1, 2, 3, 5])
def test_there_is_a_term_for_each_net_and_one_more(tmp_path: Path, nets: int) -> None:
    of = sessions(nets=nets)
    assert of.terms.shape == (len(TASKS), 3, nets + 1)
    assert of.prediction_mean.shape[3] == of.prediction_std.shape[3] == nets
    of.terms[:, 0] = np.arange(nets + 1)
    save(tmp_path / "s.zarr", [of], {"members": list(range(7, 7 + nets))})
    np.testing.assert_array_equal(load(tmp_path / "s.zarr").terms, of.terms)
    assert load_members(tmp_path / "s.zarr") == tuple(range(7, 7 + nets))
    with pytest.raises(ValueError, match=f"terms: expected one of each of {nets} nets and u, found {nets + 2}"):
        dataclasses.replace(of, terms=np.zeros((*of.terms.shape[:2], nets + 2), np.float32))


def with_terms(path: Path, terms: np.ndarray) -> None:
    """The store with another array of terms, of that shape."""
    group = zarr.open_group(path)
    del group["terms"]
    names = ("task", "step", "term")
    group.create_array("terms", data=terms, chunks=(1, *terms.shape[1:]), dimension_names=names)


def test_stores_from_before_nets_had_any_number_mean_what_they_meant(tmp_path: Path) -> None:
    """Those of a single net have NaN in place of a second net's term; those of two nets have three terms anyway."""
    one, two = sessions(nets=1), sessions(nets=2)
    one.terms[:, 0], two.terms[:, 0] = (0.5, 0.25), (0.5, 0.75, 0.25)
    for name, of in (("one", one), ("two", two)):
        save(tmp_path / name, [of], {})
    with_terms(tmp_path / "one", np.insert(one.terms, 1, np.nan, axis=-1))
    for name, of in (("one", one), ("two", two)):
        np.testing.assert_array_equal(load(tmp_path / name).terms, of.terms)
        np.testing.assert_array_equal(load(tmp_path / name, slice(3, 5)).terms, of.terms[3:5])
    assert (load_members(tmp_path / "one"), load_members(tmp_path / "two")) == ((0,), (0, 1))


@pytest.mark.parametrize(
    ("nets", "count", "sentence"),
    [
        (1, 3, "terms: expected 2, one of each net and u, found 3"),
        (1, 1, "terms: expected 2, one of each net and u, found 1"),
        (3, 3, "terms: expected 4, one of each net and u, found 3"),
    ],
)
def test_another_number_of_terms_is_told(tmp_path: Path, nets: int, count: int, sentence: str) -> None:
    save(tmp_path / "s.zarr", [sessions(nets=nets)], {})
    with_terms(tmp_path / "s.zarr", np.ones((len(TASKS), 3, count), np.float32))
    with pytest.raises(InputError, match=sentence):
        load(tmp_path / "s.zarr")


@pytest.mark.parametrize("members", [[0], [1, 1], [0, -1], [0, 1.0], [0, True], "01", None, {"0": 1, "1": 0}])
def test_members_that_are_none_are_told(tmp_path: Path, members: object) -> None:
    save(tmp_path / "s.zarr", [sessions(nets=2)], {"members": members})
    with pytest.raises(InputError, match=r"s\.zarr: attribute members: expected a number for each of 2 nets, found"):
        load_members(tmp_path / "s.zarr")


@pytest.mark.parametrize("name", vars(sessions()))
def test_no_array_can_be_lost_unseen(tmp_path: Path, name: str) -> None:
    save(tmp_path / "s.zarr", [sessions()], {})
    load(tmp_path / "s.zarr")
    shutil.rmtree(tmp_path / "s.zarr" / name / "c")
    with pytest.raises(InputError, match=rf"s\.zarr: array {name}: chunk .* is missing"):
        load(tmp_path / "s.zarr")


@pytest.mark.parametrize("splits", [["exam"], "test", None, []])
def test_splits_that_are_none_are_told(tmp_path: Path, splits: object) -> None:
    save(tmp_path / "s.zarr", [sessions()], {})
    zarr.open_group(tmp_path / "s.zarr").attrs["splits"] = splits
    with pytest.raises(InputError, match=r"attribute splits: expected names of|split of session 0: expected"):
        load_tasks(tmp_path / "s.zarr")


@pytest.mark.parametrize("left", [0, 1, 1000, -100])
def test_a_damaged_piece_of_work_is_told(tmp_path: Path, left: int) -> None:
    path = tmp_path / "sessions_000.npz"
    save_piece(path, sessions())
    np.testing.assert_array_equal(load_piece(path).state, sessions().state)
    path.write_bytes(path.read_bytes()[:left])
    with pytest.raises(InputError, match=r"sessions_000\.npz: what an earlier run left is damaged \(.*; delete this"):
        load_piece(path)
