"""Every zarr store that stages write, opened by xarray: named dimensions, units, labels, and one file of metadata."""

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from clothkit.dataset import store
from clothkit.dataset.store import LABELS, LENGTHS, PROPERTY_UNITS, Dataset
from clothkit.episodes import record
from clothkit.evaluation import arrays
from clothkit.report.card.columns import MEANINGS
from clothkit.simulation.settings import DRAWN
from tests.dataset.test_store import digest, make
from tests.evaluation.test_arrays import estimates
from tests.tiny import sessions

ATTRIBUTES = {"stage": "test", "params": {"nested": [1, 2]}}


def dataset() -> Dataset:
    return dataclasses.replace(make(), evaluated=np.ones(5, bool))


def predictions() -> dict[str, np.ndarray]:
    meshes = make(2).vertices
    return {
        "sequence": np.arange(2),
        "start": meshes[:, 0],
        "mean": meshes[:, 1:],
        "std": np.ones_like(meshes[:, 1:]),
        "shift": make(2).centre[:, 1:],
    }


def pictures() -> dict[str, np.ndarray]:
    return {
        "sequence": np.arange(2),
        "shown": np.array([1, 3]),
        "height": np.zeros((2, 3, 4, 5), np.float32),
        "voxels": np.zeros((2, 3, 32, 32, 16), bool),
        "mesh": np.ones((2, 3, 32, 32, 3), np.float32),
    }


STORES: dict[str, Callable[[Path], Any]] = {
    "meshes": lambda path: store.save(path, dataset(), ATTRIBUTES),
    "estimates": lambda path: arrays.save(path, estimates(), arrays.ESTIMATES, ATTRIBUTES),
    "predictions": lambda path: arrays.save(path, predictions(), arrays.PREDICTIONS, ATTRIBUTES),
    "pictures": lambda path: arrays.save(path, pictures(), arrays.PICTURES, ATTRIBUTES),
    "sessions": lambda path: record.save(path, [sessions(dataset())] * 2, ATTRIBUTES),
}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stores")
    for name, write in STORES.items():
        write(folder / f"{name}.zarr")
    return folder


def arrays_of(path: Path) -> dict[str, zarr.Array]:
    """By zarr itself, each array from its own metadata."""
    return dict(zarr.open_group(path, mode="r", use_consolidated=False).arrays())


@pytest.mark.parametrize("name", STORES)
def test_xarray_opens_a_store_as_it_is(written: Path, name: str) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("dask")
    opened = xarray.open_zarr(written / f"{name}.zarr", consolidated=True)  # an error without consolidated metadata
    expected = arrays_of(written / f"{name}.zarr")
    assert set(opened.variables) == set(expected)
    for key, array in expected.items():
        variable = opened[key]
        assert variable.dims == array.metadata.dimension_names
        assert variable.attrs["units"], key
        np.testing.assert_array_equal(variable.values, array[...])
    assert opened.attrs["params"] == ATTRIBUTES["params"]
    labelled = opened.assign_coords(opened.attrs["labels"])
    if "component" in labelled.dims:
        moved = labelled["manipulation" if name == "meshes" else "plan"].sel(component=["dx", "dy"])
        assert moved.sizes["component"] == 2
    assert set(opened.attrs["labels"]) == set(opened.dims) & set(LABELS)


def test_a_state_is_chosen_by_name(written: Path) -> None:
    xarray = pytest.importorskip("xarray")
    opened = xarray.open_zarr(written / "meshes.zarr", chunks=None)
    labelled = opened.assign_coords(opened.attrs["labels"])
    height = labelled["vertices"].sel(xyz="z").isel(sequence=1, state=2).max()
    assert float(height) == dataset().vertices[1, 2, ..., 2].max()
    property_units = dict(zip(DRAWN, opened["material"].attrs["units"].split(", "), strict=True))
    assert property_units["bending_stiffness"] == "N m"


@pytest.mark.parametrize("name", STORES)
def test_the_group_s_own_file_tells_of_every_array(written: Path, name: str) -> None:
    """The same as each array's own file, and in the same bytes each time."""
    stored = json.loads((written / f"{name}.zarr/zarr.json").read_text())["consolidated_metadata"]["metadata"]
    for key in arrays_of(written / f"{name}.zarr"):
        own = json.loads((written / f"{name}.zarr" / key / "zarr.json").read_text())
        assert stored.pop(key) == own
    assert stored == {}
    assert list(stored) == sorted(stored)


@pytest.mark.parametrize("name", STORES)
def test_equal_values_give_equal_bytes_wherever(written: Path, tmp_path: Path, name: str) -> None:
    STORES[name](tmp_path / "again.zarr")
    assert digest(tmp_path / "again.zarr") == digest(written / f"{name}.zarr")


def test_what_plans_in_voxels_has_the_units_of_voxels(tmp_path: Path) -> None:
    whole = sessions(dataset())
    none = {name: getattr(whole, name)[..., :0, :0, :0] for name in ("prediction_std", "refined")}
    record.save(tmp_path / "b4.zarr", [dataclasses.replace(whole, **none)], {})
    units = {name: array.attrs["units"] for name, array in arrays_of(tmp_path / "b4.zarr").items()}
    assert (units["estimate"], units["prediction_mean"], units["plan"]) == ("1", "1", "normalised")
    assert (units["state"], units["error_otherwise"]) == ("normalised", "cloth length")


def test_there_is_a_label_for_each_place() -> None:
    for dimension, names in LABELS.items():
        assert len(names) == LENGTHS[dimension]
    card = MEANINGS["cloths.parquet"]
    assert tuple(card[name][0] or "1" for name in DRAWN) == PROPERTY_UNITS


def test_a_store_without_consolidated_metadata_is_read_as_before(written: Path, tmp_path: Path) -> None:
    """Such are those of earlier versions."""
    path = shutil.copytree(written / "meshes.zarr", tmp_path / "old.zarr")
    stored = json.loads((path / "zarr.json").read_text())
    del stored["consolidated_metadata"], stored["attributes"]["labels"]
    (path / "zarr.json").write_text(json.dumps(stored))
    np.testing.assert_array_equal(store.load(path).vertices, dataset().vertices)
