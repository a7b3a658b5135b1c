"""Stored evaluations with each fault, one by one."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clothkit.evaluation.arrays import ESTIMATES, PICTURES, load, save
from clothkit.runtime.errors import InputError

Arrays = dict[str, np.ndarray]


def estimates() -> Arrays:
    """Of three sequences, of three, one and two manipulations, labels 0 but for the last state of all."""
    present = np.arange(4) <= np.array([3, 1, 2])[:, None]
    values = np.random.default_rng(0).uniform(0.1, 1, (3, 3, 4, 32, 32, 3)).astype(np.float32)
    values[:, ~present] = np.nan
    label = np.where(present, 0, -1).astype(np.int32)
    label[2, 2] = 5
    mean, std, mesh = values
    return {"sequence": np.array([0, 4, 7]), "mean": mean, "std": std, "mesh": mesh, "label": label}


def write(path: Path, arrays: Arrays) -> Path:
    save(path, arrays, ESTIMATES, {})
    return path


def replaced(name: str, place: Any, value: float) -> Callable[[Arrays], None]:
    return lambda arrays: arrays[name].__setitem__(place, value)


FAULTS: dict[str, tuple[Callable[[Arrays], Any], str]] = {
    "twice": (replaced("sequence", 1, 7), "array sequence: expected another sequence in each row"),
    "negative": (replaced("sequence", 0, -2), "array sequence: expected"),
    "no width": (replaced("std", (0, 0, 0, 0, 0), 0), "array std: expected values above 0"),
    "NaN": (replaced("mean", (0, 1, 3, 3, 1), np.nan), "array mean: expected finite values"),
    "infinite": (replaced("mesh", (2, 0, 0, 0, 0), np.inf), "array mesh: expected finite values"),
    "label 8": (replaced("label", (0, 0), 8), "array label: expected labels 0 to 7"),
    "label past": (replaced("label", (1, 3), 0), "array label: expected -1 past a sequence's end alone"),
    "no label": (replaced("label", (0, 3), -1), "array label: expected -1 past a sequence's end alone"),
    "of another kind": (
        lambda arrays: arrays.update(mean=arrays["mean"].astype(float)),
        "mean holds float64",
    ),
    "of other length": (lambda arrays: arrays.update(label=arrays["label"][:2]), r"label has shape \(2, 4\), expected"),
    "gone": (lambda arrays: arrays.pop("mesh"), "has no array mesh, expected a result of an evaluation"),
}


@pytest.mark.parametrize(("damage", "sentence"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_one_sentence(tmp_path: Path, damage: Callable[[Arrays], Any], sentence: str) -> None:
    arrays = estimates()
    damage(arrays)
    with pytest.raises(InputError, match=sentence) as told:
        load(write(tmp_path / "estimates.zarr", arrays), ESTIMATES)
    assert str(told.value).startswith(f"{tmp_path}/estimates.zarr: ")
    assert len(str(told.value).splitlines()) == 1


def test_what_is_healthy_is_read(tmp_path: Path) -> None:
    arrays = estimates()
    found = load(write(tmp_path / "estimates.zarr", arrays), ESTIMATES)
    assert found.keys() == arrays.keys()
    for name, values in arrays.items():
        np.testing.assert_array_equal(found[name], values)


def test_no_array_can_be_lost_unseen(tmp_path: Path) -> None:
    healthy = write(tmp_path / "estimates.zarr", estimates())
    for name in ESTIMATES:
        store = shutil.copytree(healthy, tmp_path / name)
        shutil.rmtree(store / name / "c")
        with pytest.raises(InputError, match=str(store)):
            load(store, ESTIMATES)


def test_one_sequence_of_number_0_in_labels_0_comes_back(tmp_path: Path) -> None:
    arrays = {name: values[:1] for name, values in estimates().items()}
    found = load(write(tmp_path / "estimates.zarr", arrays), ESTIMATES)
    assert found["label"].tolist() == [[0] * 4]
    assert found["sequence"].tolist() == [0]


def test_pictures_of_what_was_not_seen(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    arrays = {
        "sequence": np.arange(2),
        "shown": np.array([1, 3]),
        "height": rng.uniform(-1, 1, (2, 3, 4, 5)).astype(np.float32),
        "voxels": np.zeros((2, 3, 32, 32, 16), bool),
        "mesh": rng.normal(size=(2, 3, 32, 32, 3)).astype(np.float32),
    }
    save(tmp_path / "p.zarr", arrays, PICTURES, {})
    assert not load(tmp_path / "p.zarr", PICTURES)["voxels"].any()
    for shown in ([0, 1], [1, 4]):
        arrays["shown"] = np.array(shown)
        save(tmp_path / "p.zarr", arrays, PICTURES, {})
        with pytest.raises(InputError, match="array shown: expected states 1 to 3"):
            load(tmp_path / "p.zarr", PICTURES)
