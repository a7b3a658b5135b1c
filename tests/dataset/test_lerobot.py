"""Sequences as a LeRobotDataset: what the format wants, by hand; and by LeRobot's own reader where it is installed."""

import dataclasses
import importlib
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from clothkit.app.cli import cli
from clothkit.dataset import lerobot, store
from clothkit.dataset.lerobot import write_lerobot
from clothkit.dataset.recorded import read_recorded
from clothkit.dataset.store import Dataset
from tests.dataset.test_store import digest, make

SIDE = 0.5
DEFAULTS = {
    "timestamp": ("float32", [1]),
    "frame_index": ("int64", [1]),
    "episode_index": ("int64", [1]),
    "index": ("int64", [1]),
    "task_index": ("int64", [1]),
}
"""Features that every LeRobotDataset has."""


def dataset() -> Dataset:
    """Five sequences, of which the first is of the test split, and the third ends after one manipulation."""
    whole = dataclasses.replace(make(), split=np.array([2, 0, 1, 0, 2], np.int8))
    whole.length[2] = 1
    whole.vertices[2, 2:] = whole.centre[2, 2:] = whole.manipulation[2, 1:] = np.nan
    return whole


ORDER = [1, 3, 2, 0, 4]
"""The sequences of `dataset` by split: two to train on, one for validation, two tests."""


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("meshes") / "meshes.zarr"
    store.save(path, dataset(), {})
    return path


@pytest.fixture(scope="module")
def exported(meshes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As the command makes it, with pictures."""
    folder = tmp_path_factory.mktemp("lerobot") / "cloths"
    words = ["export", str(meshes), "--all", "--format", "lerobot", "--cloth-side", str(SIDE), "--pictures", "32"]
    result = CliRunner().invoke(cli, [*words, "--to", str(folder)])
    assert result.exit_code == 0, result.output
    assert f"7 files in {folder}, a dataset of format lerobot\n" in result.output
    return folder


def frames_of(folder: Path) -> pd.DataFrame:
    return pd.concat([pd.read_parquet(path) for path in sorted((folder / "data").glob("*/*.parquet"))])


def info_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "meta/info.json").read_text())


def test_frames_are_the_states_and_actions_the_manipulations(exported: Path) -> None:
    whole, frames = dataset(), frames_of(exported)
    assert len(frames) == 4 * 4 + 2
    assert frames["index"].tolist() == list(range(18))
    for episode, sequence in enumerate(ORDER):
        own = frames[frames["episode_index"] == episode]
        length = whole.length[sequence]
        assert own["frame_index"].tolist() == list(range(length + 1))
        assert own["timestamp"].tolist() == list(range(length + 1))  # one frame a second
        assert own["next.done"].tolist() == [False] * length + [True]
        states = np.stack(own["observation.state"]).reshape(length + 1, 32, 32, 3)
        lay = whole.vertices[sequence, : length + 1].astype(float)
        lay[..., :2] += whole.centre[sequence, : length + 1, None, None]
        np.testing.assert_allclose(states, lay * (SIDE / 1.4), atol=1e-6)
        actions = np.stack(own["action"])
        np.testing.assert_array_equal(actions[:-1], whole.manipulation[sequence, :length])
        assert not actions[-1].any()
        for cloth in own["observation.environment_state"]:
            np.testing.assert_allclose(cloth, whole.cloth[0] * SIDE / 1.4)


def test_the_description_is_of_version_3(exported: Path) -> None:
    info = info_of(exported)
    assert (info["codebase_version"], info["fps"], info["total_tasks"]) == ("v3.0", 1, 1)
    assert (info["total_episodes"], info["total_frames"]) == (5, 18)
    assert info["splits"] == {"train": "0:2", "validation": "2:3", "test": "3:5"}
    files = [str(path.relative_to(exported)) for path in exported.glob("data/*/*")]
    assert files == [info["data_path"].format(chunk_index=0, file_index=0)]
    features = info["features"]
    for name, (dtype, shape) in DEFAULTS.items():
        assert (features[name]["dtype"], features[name]["shape"], features[name]["names"]) == (dtype, shape, None)
    assert features["action"]["names"] == ["u1", "v1", "u2", "v2", "dx", "dy"]
    names = features["observation.state"]["names"]
    assert len(names) == len(set(names)) == features["observation.state"]["shape"][0] == 3072
    assert names[3 * 33 + 2] == "vertex_33_z"
    assert not any("/" in name for name in features)  # which the format takes for nesting
    schema = pq.read_schema(exported / files[0])
    assert set(schema.names) == set(features)
    for name, feature in features.items():
        if len(feature["shape"]) == 1 and feature["shape"] != [1]:
            assert (schema.field(name).type.list_size, str(schema.field(name).type.value_type)) == (
                feature["shape"][0],
                "float",
            )
    tasks = pd.read_parquet(exported / "meta/tasks.parquet")
    assert tasks.index.tolist() == [lerobot.TASK]
    assert tasks["task_index"].tolist() == [0]


def test_episodes_say_where_their_frames_are(exported: Path) -> None:
    frames = frames_of(exported)
    episodes = pd.read_parquet(exported / "meta/episodes/chunk-000/file-000.parquet")
    assert episodes["sequence"].tolist() == ORDER
    groups = pq.ParquetFile(exported / "data/chunk-000/file-000.parquet")
    assert groups.num_row_groups == len(episodes)  # so that one can be read alone
    for episode, row in episodes.iterrows():
        own = frames.iloc[row["dataset_from_index"] : row["dataset_to_index"]]
        assert own["episode_index"].unique().tolist() == [row["episode_index"]] == [episode]
        assert len(own) == row["length"]
        assert row["tasks"].tolist() == [lerobot.TASK]
        assert (row["data/chunk_index"], row["data/file_index"], row["meta/episodes/file_index"]) == (0, 0, 0)
        np.testing.assert_allclose(row["stats/action/mean"], np.stack(own["action"]).mean(0), rtol=1e-6)
        assert row["stats/action/count"].tolist() == [len(own)]


def test_statistics_are_over_all_frames(exported: Path) -> None:
    frames, stats = frames_of(exported), json.loads((exported / "meta/stats.json").read_text())
    assert set(stats) == set(info_of(exported)["features"])
    for name in ("observation.state", "action", "timestamp"):
        values = np.stack(frames[name]).astype(float).reshape(18, -1)
        for statistic, expected in {
            "min": values.min(0),
            "max": values.max(0),
            "mean": values.mean(0),
            "std": values.std(0),
            "q01": np.quantile(values, 0.01, axis=0),
            "q90": np.quantile(values, 0.9, axis=0),
        }.items():
            np.testing.assert_allclose(stats[name][statistic], expected, atol=1e-9, err_msg=f"{name} {statistic}")
        assert stats[name]["count"] == [18]
    pictures = np.stack([picture(cell) for cell in frames["observation.images.top"]]) / 255
    assert pictures.shape == (18, 32, 32, 3)
    top = stats["observation.images.top"]
    np.testing.assert_allclose(np.squeeze(top["mean"]), pictures.mean((0, 1, 2)), atol=1e-12)
    np.testing.assert_allclose(np.squeeze(top["std"]), pictures.std((0, 1, 2)), atol=1e-9)
    assert np.shape(top["max"]) == (3, 1, 1)
    by_value = np.sort(pictures.reshape(-1, 3), axis=0)
    assert abs(np.searchsorted(by_value[:, 0], top["q10"][0][0][0], side="right") / len(by_value) - 0.1) < 0.05


def picture(cell: dict[str, Any]) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(cell["bytes"], np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


def test_many_episodes_are_many_files_and_the_same_bytes_again(
    meshes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lerobot, "EPISODES_PER_FILE", 2)
    for name in ("once", "again"):
        (tmp_path / name).mkdir()
        write_lerobot(tmp_path / name, read_recorded(meshes, None, cloth_side=SIDE))
    assert digest(tmp_path / "once") == digest(tmp_path / "again")
    names = [f"chunk-000/file-{number:03d}.parquet" for number in range(3)]
    for folder in ("data", "meta/episodes"):
        assert sorted(str(p.relative_to(tmp_path / "once" / folder)) for p in (tmp_path / "once").glob(f"{folder}/*/*"))
    episodes = pd.concat([pd.read_parquet(tmp_path / "once/meta/episodes" / name) for name in names])
    assert episodes["data/file_index"].tolist() == [0, 0, 1, 1, 2]
    assert episodes["dataset_to_index"].tolist() == [4, 8, 10, 14, 18]
    assert frames_of(tmp_path / "once")["index"].tolist() == list(range(18))


@pytest.mark.filterwarnings("ignore")
def test_lerobot_reads_it(exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the package's own reader. It may not be installed: it needs torch."""
    pytest.importorskip("lerobot")
    pytest.importorskip("torch")
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("HF_DATASETS_CACHE", str(tmp_path / "cache"))
    reader = importlib.import_module("lerobot.datasets.lerobot_dataset").LeRobotDataset
    opened = reader("me/cloths", root=exported, delta_timestamps={"observation.state": [0, 1]})
    assert (len(opened), opened.num_episodes, opened.fps) == (18, 5, 1)
    frame, whole = opened[1], frames_of(exported)
    for after in range(2):
        expected = whole["observation.state"].iloc[1 + after]
        np.testing.assert_array_equal(frame["observation.state"][after].numpy(), expected)
    np.testing.assert_array_equal(frame["action"].numpy(), whole["action"].iloc[1])
    top = picture(whole["observation.images.top"].iloc[1]) / 255
    np.testing.assert_allclose(frame["observation.images.top"].numpy(), np.moveaxis(top, -1, 0), atol=1e-6)
    assert frame["task"] == lerobot.TASK
    assert opened[3]["observation.state_is_pad"].tolist() == [False, True]
