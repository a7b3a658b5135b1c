"""The study of the number of nets: which nets it takes, when it trains them, and what it makes of the rows."""

import json
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import jax
import numpy as np
import pandas as pd
import pytest

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.dataset.store import SPLITS, Dataset
from clothkit.dataset.tasks import TASKS
from clothkit.evaluation.prediction import Starts
from clothkit.models import store
from clothkit.models.ensemble import folder
from clothkit.models.net import Net
from clothkit.models.pemd import initial
from clothkit.models.settings import PEMDConfig
from clothkit.params import Params, load_params
from clothkit.training.loop import CHECKPOINT, Trained
from tests import tiny, toy_dataset
from tests.planning import toy

NET = PEMDConfig(latent=3, encoder=(4,), manipulation=3, decoder=(4,))
WEIGHTS = initial(NET, key=jax.random.key(0))
HISTORY = pd.DataFrame({"iteration": [1], "score": [0.1]})


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(tiny.ROOT / "studies")
    return import_module("ensemble")


@pytest.fixture(scope="module")
def params() -> Params:
    return load_params(tiny.ROOT / "params.yaml")


@pytest.fixture(autouse=True)
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder with the two nets of params.yaml, of which the second is the better one, and data to hash."""
    monkeypatch.chdir(tmp_path)
    for member, score in ((0, 0.2), (1, 0.1)):
        store.save(folder(Path("data/nets"), "pemd", member), Net(NET, WEIGHTS), HISTORY, {"validation_score": score})
    for name in ("meshes.zarr", "augmented.zarr"):
        Path("data", name).write_text(name)


def test_the_nets_of_an_ensemble(study: ModuleType) -> None:
    own, more = Path("data/nets/pemd"), Path("data/studies/ensemble/pemd")
    assert study.places(1, (0, 1)) == {1: own / "1"}
    assert study.places(2, (0, 1)) == {0: own / "0", 1: own / "1"}
    assert study.places(5, (0, 1)) == {0: own / "0", 1: own / "1", **{m: more / str(m) for m in (2, 3, 4)}}
    assert list(study.places(2, (0, 4, 1))) == [0, 4]
    assert list(study.places(4, (0, 4))) == [0, 4, 1, 2]


def test_training_is_the_stages_and_is_done_once(
    study: ModuleType, params: Params, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[Any] = []

    def train(settings: Any, training: Any, validation: Any, *, work: Path, key: jax.Array) -> Trained:
        calls.append((settings, training, validation, key))
        if len(calls) == 2:
            (work / CHECKPOINT).write_text("half")
            raise KeyboardInterrupt
        return Trained(WEIGHTS, 0.3, HISTORY)

    monkeypatch.setattr(study.trained, "train_pemd", train)
    monkeypatch.setattr(study.store, "load", lambda path: path)
    small = replace(params.stages.train_pemd, net=NET, training=replace(params.stages.train_pemd.training, seed=7))
    fake: Any = SimpleNamespace(
        scale="laptop", stages=SimpleNamespace(train_pemd=small), section=lambda stage: {"stage": stage}
    )
    for _ in range(2):
        study.train(2, fake, "validation")
    ((settings, training, validation, key),) = calls
    assert (settings, training, validation) == (small, Path("data/augmented.zarr"), "validation")
    np.testing.assert_array_equal(
        jax.random.key_data(key), jax.random.key_data(jax.random.fold_in(jax.random.key(7), 2))
    )
    found = Path("data/studies/ensemble/pemd/2")
    assert store.validation_score(found) == 0.3
    assert set(json.loads(found.with_suffix(".json").read_text())) == {"seconds", "cpu_seconds"}
    # With other data it is trained again; what an interrupted and resumed training took is not known.
    Path("data/augmented.zarr").write_text("other")
    with pytest.raises(KeyboardInterrupt):
        study.train(2, fake, "validation")
    assert not study.is_trained(found, study.of_training(fake, 2))
    study.train(2, fake, "validation")
    assert len(calls) == 3
    assert json.loads(found.with_suffix(".json").read_text()) == {"seconds": None, "cpu_seconds": None}
    assert study.is_trained(found, study.of_training(fake, 2))
    assert not list(Path(".work").rglob(CHECKPOINT))


def test_minutes_of_nets_that_were_not_measured_are_the_mean_of_the_others(study: ModuleType, params: Params) -> None:
    reports, more = Path("reports"), Path("data/studies/ensemble/pemd")
    assert np.isnan(study.training_minutes([2], params, reports)["training_minutes"][2])
    reports.mkdir()
    (reports / "timings.csv").write_text("stage,seconds,cpu_seconds\ntrain_pemd@0,60,120\ntrain_vtm,1,1\n")
    more.mkdir(parents=True)
    (more / "2.json").write_text('{"seconds": 180, "cpu_seconds": 240}')
    (more / "3.json").write_text('{"seconds": null, "cpu_seconds": null}')
    found = study.training_minutes([1, 2, 3, 4, 5], params, reports)
    # Net 0: 2 CPU minutes, net 2: 4. The others, among them the single net, 1: the mean, 3.
    assert found["training_minutes"] == {1: 3, 2: 5, 3: 9, 4: 12, 5: 15}
    assert found["training_wall_minutes"] == {1: 2, 2: 3, 3: 6, 4: 8, 5: 10}


def test_errors_of_an_ensemble_and_of_its_nets(study: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset: Dataset = toy_dataset.dataset(3)
    dataset = replace(dataset, length=np.array([3, 1, 3], np.int8))
    meshes = dataset.vertices[[0, 1]].copy()

    def predict(
        net: float, mesh: np.ndarray, manipulations: np.ndarray, batch: int, cloth: np.ndarray
    ) -> tuple[Any, None]:
        """The truth, by a net's height too high."""
        step = manipulations.shape[1]
        means = [
            next(states[i + step] for states in meshes for i in range(4 - step) if (states[i] == start).all())
            for start in mesh
        ]
        raised = np.stack(means)[None] + np.array([0, 0, net], np.float32)
        return ProbabilisticMesh(raised, raised), None

    monkeypatch.setattr(study.prediction, "predict", predict)
    rows = study.predicted(dataset, Starts(np.array([0, 1]), {"main": meshes}), [0.03, -0.01, 0.01], 4)
    assert set(zip(rows["sequence"], rows["start"], rows["length"], strict=True)) == {
        *((0, *task) for task in TASKS),
        (1, 0, 1),
    }
    np.testing.assert_allclose(rows["prediction_error"], 0.01 / 1.4, rtol=1e-3)
    np.testing.assert_allclose(rows["prediction_error_single"], 0.05 / 3 / 1.4, rtol=1e-3)


def test_summary(study: ModuleType) -> None:
    rows = []
    for nets in (1, 2, 3):
        for sequence in range(12):
            for start, length in TASKS:
                error = 0.1 * length + 0.01 * sequence + {1: 0.02, 2: 0.0, 3: -0.01 * start}[nets]
                found = {"prediction_error": error, "prediction_error_single": 2 * error, "uncertainty": 1.0 * nets}
                found |= {"loss": 1.0, "loss_recorded": 0.5 if sequence < nets else 1.0, "seconds": 1.0 * nets * length}
                rows.append({"split": "validation", "nets": nets, "sequence": sequence, "start": start, **found})
                rows[-1] |= {"length": length, "error": error}
    found = study.summary(pd.DataFrame(rows), {"training_minutes": {1: 10.0, 2: 20.0, 3: 30.0}})
    assert not found.duplicated(["nets", "measure", "column"]).any()
    indexed = found.set_index(["nets", "measure", "column"])
    errors = indexed.xs("error", level="measure")
    # Sequences differ by 0 to 0.11, in the mean by 0.055.
    assert errors.loc[(2, "2/all"), "mean"] == pytest.approx(0.255)
    assert errors.loc[(2, "2/all"), "low"] < 0.255 < errors.loc[(2, "2/all"), "high"]
    assert errors.loc[(2, "2/all"), ["difference", "p"]].isna().all()
    difference = ["difference", "difference_low", "difference_high"]
    np.testing.assert_allclose(errors.loc[(1, "2/all"), difference].astype(float), 0.02)
    np.testing.assert_allclose(errors.loc[(3, "1/all"), difference].astype(float), -0.01)
    np.testing.assert_allclose(errors.loc[(3, "1/2"), difference].astype(float), -0.02)
    assert errors.loc[(1, "2/all"), "p"] < 0.01
    assert errors.loc[(3, "1/0"), "p"] == pytest.approx(1)
    assert indexed.loc[(3, "failure", "3/all"), "mean"] == pytest.approx(3 / 12)
    assert indexed.loc[(3, "failure", "3/all"), "difference"] == pytest.approx(1 / 12)
    # A single net has no u.
    assert set(found.loc[found["measure"] == "uncertainty", "nets"]) == {2, 3}
    assert indexed.loc[(3, "uncertainty", "1/0"), "difference"] == pytest.approx(1)
    assert indexed.loc[(2, "seconds", "3/all"), "mean"] == pytest.approx(6)
    assert indexed.loc[(3, "training_minutes", "all"), "mean"] == 30
    assert (errors["sequences"] == 12).all()


def test_only_what_is_missing_is_computed(study: ModuleType, params: Params, monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole study, with sessions, references and predictions that take no time."""
    Path("params.yaml").write_text((tiny.ROOT / "params.yaml").read_text())
    Path("data/nets/vtm").write_text("vtm")
    dataset = toy_dataset.dataset(3)
    dataset = replace(dataset, split=np.full(3, SPLITS.index("validation"), np.int8))
    calls: list[tuple[tuple[int, ...], int, list[int]]] = []

    def planned(dataset: Dataset, sequences: list[int], planner: Any, params: Params) -> pd.DataFrame:
        calls.append((planner.members, planner.best, sequences))
        keys = {"sequence": np.repeat(sequences, 6)}
        keys |= dict(zip(("start", "length"), np.tile(np.array(TASKS).T, len(sequences)), strict=True))
        assert len(planner.normalisation.low) == len(planner.nets)
        measured = dict.fromkeys(("error", "uncertainty", "loss", "loss_recorded", "seconds"), 0.5)
        return pd.DataFrame({"split": "validation", "system": "main", **keys, **measured})

    def train(member: int, params: Params, validation: Dataset) -> None:
        found, current = folder(study.OWN, "pemd", member), study.of_training(params, member)
        if not study.is_trained(found, current):
            store.save(found, Net(NET, WEIGHTS), HISTORY, {"validation_score": 0.3, study.COLUMN: current})

    def predict(
        net: Net, mesh: np.ndarray, manipulations: np.ndarray, batch: int, cloth: np.ndarray
    ) -> tuple[ProbabilisticMesh, None]:
        return ProbabilisticMesh(mesh[None], mesh[None]), None

    def run(*arguments: str) -> list[tuple[tuple[int, ...], int, list[int]]]:
        calls.clear()
        monkeypatch.setattr("sys.argv", ["ensemble.py", *arguments])
        study.main()
        return list(calls)

    monkeypatch.setattr(study, "planned", planned)
    monkeypatch.setattr(study, "train", train)
    monkeypatch.setattr(study.prediction, "predict", predict)
    monkeypatch.setattr(study.store, "load", lambda path: dataset)
    monkeypatch.setattr(study, "starts", lambda *_: Starts(np.arange(3), {"main": dataset.vertices}))
    monkeypatch.setattr(study, "assemble", lambda *_: toy.planner("main"))
    monkeypatch.setattr(study, "normalise", lambda model, representation, nets, *_: toy.normalisation(len(nets)))
    rows, summary = (Path("reports/laptop/studies") / name for name in ("ensemble.csv", "ensemble_summary.csv"))
    assert run("2", "--counts", "3", "--train-only") == []
    assert not rows.exists()
    # The single net is member 1, the better one of params.yaml's two.
    assert run("2", "--counts", "1", "3") == [((1,), 0, [0, 1]), ((0, 1, 2), 1, [0, 1])]
    first = rows.read_text()
    assert run("2", "--counts", "1", "3") == []
    assert rows.read_text() == first
    assert run("3", "--counts", "3") == [((0, 1, 2), 1, [2])]
    found = pd.read_csv(rows)
    assert found.groupby("nets").size().to_dict() == {1: 12, 3: 18}
    moved = dataset.vertices[:, 1:] - dataset.vertices[:, :-1]
    one_step = found[(found["nets"] == 3) & (found["length"] == 1)]
    assert (one_step["prediction_error"] <= np.linalg.norm(moved, axis=-1).mean((-2, -1)).max() / 1.4).all()
    # With other training data the third net is another one: rows of ensembles with it are out of date, no others.
    Path("data/augmented.zarr").write_text("other")
    assert run("3", "--counts", "3") == [((0, 1, 2), 1, [0, 1, 2])]
    assert pd.read_csv(rows).groupby("nets").size().to_dict() == {1: 12, 3: 18}
    picture = summary.with_name("ensemble.png")
    picture.unlink()
    assert run("--draw") == []
    assert picture.exists()
