"""Statistics that are gathered part by part, against NumPy's of everything at once."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from clothkit.dataset import lerobot, store
from clothkit.dataset.lerobot import write_lerobot
from clothkit.dataset.recorded import read_recorded
from clothkit.dataset.statistics import OfValues
from clothkit.runtime.errors import InputError

from .test_regularise import write_raw
from .test_store import make


def column(values: np.ndarray) -> pa.ChunkedArray:
    flat = pa.array(values.ravel())
    return pa.chunked_array([pa.FixedSizeListArray.from_arrays(flat, values.shape[1])])


def test_parts_of_any_length_give_the_statistics_of_the_whole() -> None:
    # Far from zero, where a sum of squares would lose all digits.
    values = (1e4 + np.random.default_rng(0).normal(size=(57, 300)) * np.arange(1, 301)).astype(np.float32)
    gathered = OfValues(300)
    for first, last in ((0, 1), (1, 30), (30, 57)):
        part = column(values[first:last])
        gathered.add([part], [part] if first else ())
    found, whole = gathered.found(), values.astype(np.float64)
    for name, expected in (
        ("min", whole.min(0)),
        ("max", whole.max(0)),
        ("mean", whole.mean(0)),
        ("std", whole.std(0)),
    ):
        np.testing.assert_allclose(found[name], expected, rtol=1e-10, err_msg=name)
    assert found["count"] == [57]
    np.testing.assert_allclose(found["q10"], np.quantile(whole[1:], 0.1, axis=0), rtol=1e-12)


def test_a_dataset_of_many_files_has_the_statistics_of_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store.save(tmp_path / "meshes.zarr", make(), {})
    told = {}
    for name, episodes, sampled in (("one", 500, 4096), ("many", 2, 4096), ("sampled", 2, 3)):
        monkeypatch.setattr(lerobot, "EPISODES_PER_FILE", episodes)
        monkeypatch.setattr(lerobot, "SAMPLED", sampled)
        (tmp_path / name).mkdir()
        write_lerobot(tmp_path / name, read_recorded(tmp_path / "meshes.zarr", None, cloth_side=0.5))
        told[name] = json.loads((tmp_path / name / "meta/stats.json").read_text())
    for feature, expected in told["one"].items():
        for statistic, values in expected.items():
            np.testing.assert_allclose(told["many"][feature][statistic], values, rtol=1e-9, atol=1e-12)
            if not statistic.startswith("q"):
                assert told["sampled"][feature][statistic] == told["many"][feature][statistic]
    frames = pd.read_parquet(tmp_path / "one/data")
    # Of five episodes, every second.
    actions = np.stack(frames.loc[frames["episode_index"] % 2 == 0, "action"]).astype(np.float64)
    np.testing.assert_allclose(told["sampled"]["action"]["q50"], np.median(actions, axis=0), rtol=1e-12)


def test_states_of_another_triangulation_are_refused(tmp_path: Path) -> None:
    """As many vertices, but another list of triangles."""
    raw = write_raw(tmp_path / "raw", 2)
    rows = pd.read_parquet(raw / "topologies.parquet")
    other = rows["triangles"][0].copy()
    other[:3] = other[[1, 2, 0]]
    both = pd.concat([rows, rows.assign(topology=1, triangles=[other])])
    both.to_parquet(raw / "topologies.parquet")
    (tmp_path / "same").mkdir()
    write_lerobot(tmp_path / "same", read_recorded(raw, None, cloth_side=0.4))
    states = pd.read_parquet(raw / "states/0.parquet")
    states.loc[6, "topology"] = 1
    states.to_parquet(raw / "states/0.parquet")
    (tmp_path / "mixed").mkdir()
    with pytest.raises(
        InputError, match=r"raw: sequence 1, state 2 has another triangulation, expected the same as in"
    ):
        write_lerobot(tmp_path / "mixed", read_recorded(raw, None, cloth_side=0.4))
