"""A repository of the Hugging Face Hub: what `datasets` and `mlcroissant` read from it, and what is in its files."""

import json
import re
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from ruamel.yaml import YAML

from clothkit.app.cli import cli
from clothkit.app.export import main
from clothkit.dataset import store
from clothkit.dataset.regularise import RegulariseConfig, regularise
from clothkit.report.card import croissant
from clothkit.report.card.inputs import PARTS, read
from clothkit.simulation.records import write_raw
from tests.app.test_export import raw as irregular
from tests.tiny import attempts

__all__ = ["irregular"]

SPLITS = {"train": 6, "validation": 2, "test": 2}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "data"
    tried, about = attempts(), {"stage": "simulate", "scale": "smoke", "params": {"seed": 0}}
    write_raw(folder / "raw", tried, [tried.states[tried.accepted]], seed=0, attributes=about)
    store.save(folder / "meshes.zarr", regularise(folder / "raw", RegulariseConfig(**SPLITS, evaluated=1)), about)
    return folder


@pytest.fixture(scope="module")
def hub(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the meshes, with the raw artifacts that lie beside them."""
    folder = tmp_path_factory.mktemp("hub") / "cloths"
    main([str(data / "meshes.zarr"), "--all", "--format", "huggingface", "--to", str(folder)])
    return folder


@pytest.fixture
def offline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("HF_DATASETS_CACHE", str(tmp_path / "cache"))


def header(folder: Path) -> dict[str, Any]:
    """The card's YAML."""
    found = re.match(r"---\n(.*?)\n---\n", (folder / "README.md").read_text(), re.DOTALL)
    assert found
    return YAML(typ="safe").load(found[1])


def test_the_card_s_header_names_the_files(hub: Path) -> None:
    told = header(hub)
    assert told["task_categories"] == ["robotics"]
    assert told["size_categories"] == ["n<1K"]
    names = [config["config_name"] for config in told["configs"]]
    assert names == ["meshes", "states", "manipulations", "attempts", "topologies", "cloths"]
    assert [config.get("default") for config in told["configs"]] == [True, *[None] * 5]
    for config in told["configs"]:
        for entry in config["data_files"]:
            assert list(hub.glob(entry["path"])), entry
    card = (hub / "README.md").read_text()
    for target in re.findall(r"\]\((\w+/[^)]+)\)", card):
        assert (hub / target).exists(), target
    assert "# The dataset" in card


def test_meshes_are_the_store_s_by_split(data: Path, hub: Path) -> None:
    whole = store.load(data / "meshes.zarr")
    for split, count in SPLITS.items():
        rows = pd.read_parquet(hub / "data/meshes" / f"{split}-00000-of-00001.parquet")
        assert rows["sequence"].tolist() == whole.indices(split).tolist()
        assert len(rows) == count
        table = pq.read_table(hub / "data/meshes" / f"{split}-00000-of-00001.parquet")
        flat = table["vertices"].combine_chunks()
        for _ in range(4):
            flat = flat.flatten()
        vertices = flat.to_numpy().reshape(count, 4, 32, 32, 3)
        np.testing.assert_array_equal(vertices, whole.of_split(split).vertices)


def test_the_code_of_the_card_runs_where_the_card_lies(hub: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(hub)
    block = re.search(r"```python\n(import pandas.*?)```", (hub / "README.md").read_text(), re.DOTALL)
    assert block
    names: dict[str, object] = {}
    exec(block[1], names)
    assert np.shape(names["after_one"]) == (1024, 3)


@pytest.mark.usefixtures("offline")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_datasets_opens_it(data: Path, hub: Path) -> None:
    datasets = pytest.importorskip("datasets")
    opened = datasets.load_dataset(str(hub))
    assert {split: len(opened[split]) for split in opened} == SPLITS
    row = opened["test"].with_format("numpy")[1]
    whole = store.load(data / "meshes.zarr").of_split("test")
    np.testing.assert_array_equal(row["vertices"], whole.vertices[1])
    np.testing.assert_array_equal(row["manipulation"], whole.manipulation[1])
    states = datasets.load_dataset(str(hub), "states")["train"]
    assert len(states) == 40
    assert states[7]["vertices"] == pd.read_parquet(data / "raw/states")["vertices"][7].tolist()


def test_some_sequences_of_raw_artifacts(data: Path, tmp_path: Path) -> None:
    words = ["--sequence", "3", "7", "--format", "huggingface", "--to", str(tmp_path / "some")]
    main([str(data / "raw"), *words])
    raw = tmp_path / "some/data/raw"
    assert pd.read_parquet(raw / "states")["sequence"].unique().tolist() == [3, 7]
    assert len(pd.read_parquet(raw / "manipulations.parquet")) == 6
    assert pd.read_parquet(raw / "cloths.parquet")["sequence"].tolist() == [3, 7]
    assert len(pd.read_parquet(raw / "attempts.parquet")) == 11
    for part in ("manipulations", "cloths"):
        assert pq.read_schema(raw / f"{part}.parquet").metadata[b"clothkit"]
    assert next(config["config_name"] for config in header(tmp_path / "some")["configs"]) == "states"
    assert "**2 sequences**" in (tmp_path / "some/README.md").read_text()


def test_some_sequences_of_a_store_come_without_raw_artifacts(data: Path, tmp_path: Path) -> None:
    """A split without sequences has no file."""
    whole = store.load(data / "meshes.zarr")
    chosen = [int(whole.indices(split)[0]) for split in ("test", "train")]
    words = [word for sequence in chosen for word in ("--sequence", str(sequence))]
    result = CliRunner().invoke(
        cli, ["export", str(data / "meshes.zarr"), *words, "--format", "huggingface", "--to", str(tmp_path / "some")]
    )
    assert result.exit_code == 0, result.output
    (only,) = header(tmp_path / "some")["configs"]
    assert [entry["split"] for entry in only["data_files"]] == ["train", "test"]
    assert not (tmp_path / "some/data/raw").exists()
    for split, sequence in zip(("test", "train"), chosen, strict=True):
        assert pd.read_parquet(tmp_path / f"some/data/meshes/{split}-00000-of-00001.parquet")["sequence"][0] == sequence


def test_every_byte_and_every_column_is_described(data: Path) -> None:
    described = croissant.describe(read(data / "raw"), data / "raw", located=croissant.LOCATED)
    json.dumps(described, allow_nan=False)
    files = {entry["@id"]: entry for entry in described["distribution"] if entry["@type"] == "cr:FileObject"}
    on_disk = [path for path in (data / "raw").rglob("*") if path.is_file()]
    assert len(files) == len(on_disk)
    for path in on_disk:
        entry = files[str(path.relative_to(data / "raw"))]
        assert entry["sha256"] == sha256(path.read_bytes()).hexdigest()
        assert entry["contentUrl"] == f"../../../data/raw/{path.relative_to(data / 'raw')}"
        assert entry["contentSize"] == f"{path.stat().st_size} B"
    for part, records in zip(PARTS, described["recordSet"], strict=True):
        path = data / "raw" / (f"{part}/0000.parquet" if part == "states" else part)
        schema = pq.read_schema(path)
        fields = {field["name"]: field for field in records["field"]}
        assert list(fields) == schema.names
        for name, field in fields.items():
            assert field["description"] != name, f"{part}: {name} has no meaning"
            assert field.get("repeated", False) == str(schema.field(name).type).startswith("list")
        assert {key["@id"] for key in records["key"]} <= {field["@id"] for field in records["field"]}
    height = next(field for field in described["recordSet"][0]["field"] if field["name"] == "vertices")
    assert height["description"].endswith("[m]")
    identifiers = [entry["@id"] for entry in (*described["distribution"], *described["recordSet"])]
    assert len(identifiers) == len(set(identifiers))


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_mlcroissant_validates_and_reads_it(data: Path, hub: Path, tmp_path: Path) -> None:
    mlcroissant = pytest.importorskip("mlcroissant")
    opened = mlcroissant.Dataset(jsonld=str(hub / "croissant.json"))
    assert not opened.metadata.issues.errors
    assert all("datePublished" in warning for warning in opened.metadata.issues.warnings)  # would differ each day
    states = pd.read_parquet(data / "raw/states")
    for row, record in enumerate(opened.records("states")):
        assert (record["states/sequence"], record["states/state"]) == (row // 4, row % 4)
        np.testing.assert_array_equal(record["states/vertices"], states["vertices"][row])
    assert row == 39
    # Beside the card of a report, whose data lie elsewhere.
    place = tmp_path / "reports/smoke/dataset"
    place.mkdir(parents=True)
    (tmp_path / "data").symlink_to(data)
    described = croissant.describe(read(data / "raw"), data / "raw", located=croissant.LOCATED)
    (place / "croissant.json").write_text(json.dumps(described))
    card = mlcroissant.Dataset(jsonld=str(place / "croissant.json"))
    assert not card.metadata.issues.errors
    moves = pd.read_parquet(data / "raw/manipulations.parquet")
    found = [record["manipulations/dx"] for record in card.records("manipulations")]
    np.testing.assert_allclose(found, moves["dx"])


@pytest.mark.parametrize("file_format", ["lerobot", "huggingface"])
def test_a_folder_that_holds_something_is_left_alone(data: Path, tmp_path: Path, file_format: str) -> None:
    (tmp_path / "mine").write_text("mine")
    with pytest.raises(SystemExit) as ended:
        main([str(data / "raw"), "--all", "--format", file_format, "--to", str(tmp_path)])
    assert ended.value.code == (
        f"export: {tmp_path}: is there already; a dataset of format {file_format} needs a new or an empty folder"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_bad_input_of_datasets_is_one_sentence(irregular: Path, data: Path, tmp_path: Path) -> None:
    """Sequences of which each state has another number of vertices; pictures for nobody; a sequence of no store."""
    for source, words, sentence in (
        (
            irregular,
            ["--format", "lerobot", "--all"],
            "sequence 3, state 1 has 5 vertices, expected 4 as in the states",
        ),
        (data / "raw", ["--format", "ply", "--all", "--pictures", "64"], "pictures are part of format lerobot alone"),
        (data / "meshes.zarr", ["--format", "huggingface", "--sequence", "12"], "has no sequence 12; it holds 10"),
        (data / "none", ["--format", "lerobot", "--all"], "not found; expected a folder of raw artifacts"),
    ):
        with pytest.raises(SystemExit, match=re.escape(sentence)) as ended:
            main([str(source), *words, "--to", str(tmp_path / "new")])
        assert len(str(ended.value.code).splitlines()) == 1
        assert not (tmp_path / "new").exists()
