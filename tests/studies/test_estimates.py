"""The studies of alarms and of refinement: their scenes and tables, on small made-up data."""

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from clothkit.cloth.topology import PAPERS_CLOTH, SQUARE
from clothkit.estimation.refine import RefineConfig
from clothkit.params import load_params
from tests import tiny

COUNT = 2


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with params.yaml and everything that stages leave under data/."""
    folder = tmp_path_factory.mktemp("studies")
    tiny.write_params(folder / "params.yaml")
    (folder / "data").mkdir()
    tiny.write_data(folder / "data", folder / "params.yaml")
    return folder


def study(monkeypatch: pytest.MonkeyPatch, workplace: Path, name: str, *arguments: str) -> Any:
    """A study's module, run to its end."""
    monkeypatch.syspath_prepend(tiny.ROOT / "studies")
    monkeypatch.chdir(workplace)
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    module = import_module(name)
    module.main()
    return module


def test_alarms_are_counted_by_scene(monkeypatch: pytest.MonkeyPatch, workplace: Path) -> None:
    module = study(monkeypatch, workplace, "alarms", str(COUNT), "--pictures", "scenes.png")
    rows = pd.read_csv("reports/smoke/studies/alarms.csv")
    shares = pd.read_csv("reports/smoke/studies/alarms_summary.csv").set_index("scene")
    assert (rows.groupby("scene").size() == COUNT).all()
    for scene, own in rows.groupby("scene"):
        assert shares.loc[scene, "noticed"] == pytest.approx(own["alarm"].mean(), abs=1e-3)
        assert shares.loc[scene, "low"] <= shares.loc[scene, "noticed"] <= shares.loc[scene, "high"]
    # Only a cloth whose thickness is told as three times what any was is out of the range of cloths.
    assert shares["unknown cloth"].to_dict() == {scene: float(scene == "thicker, told") for scene in shares.index}
    assert Path("scenes.png").stat().st_size > 10_000
    # Wilson (1927), 1 of 10, as R's prop.test(1, 10, correct = FALSE) gives it.
    assert module.wilson(1, 10) == pytest.approx((0.0179, 0.4042), abs=1e-4)


def test_states_that_are_simulated_for_the_study_are_other_ones_by_seed(
    monkeypatch: pytest.MonkeyPatch, workplace: Path
) -> None:
    monkeypatch.syspath_prepend(tiny.ROOT / "studies")
    monkeypatch.chdir(workplace)
    module, settings = import_module("alarms"), load_params(Path("params.yaml")).stages.simulate
    first, again, other = (module.chosen(module.simulated(settings, 2, seed), 2)[0] for seed in (1, 1, 2))
    assert first.shape == (2, *SQUARE.shape, 3)
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.01


def test_a_t_shirt_is_one_layer_on_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tiny.ROOT / "studies")
    module = import_module("alarms")
    for seed in range(5):
        shirt = module.t_shirt(0.01, np.random.default_rng(seed))
        assert set(np.unique(shirt[:, 2].round(6))) <= {0.02, 0.04}
        # Its area: between that of a half and of the whole cloth.
        assert 0.2 < len(shirt) * module.STEP**2 / 1.4**2 < 0.6
        assert np.abs(shirt[:, :2]).max() < 1


def test_two_cloths_and_a_hand_add_to_what_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tiny.ROOT / "studies")
    module = import_module("alarms")
    flat = np.stack([np.asarray(SQUARE.flat())] * 2)
    shown = module.scenes(flat, np.stack([PAPERS_CLOTH] * 2))
    alone = len(module.of_mesh(flat[0]))
    for scene in ("two cloths", "hand"):
        points, cloth = shown[scene](0, np.random.default_rng(0))
        assert len(points) > alone
        np.testing.assert_array_equal(points[:alone], module.of_mesh(flat[0]))
        np.testing.assert_array_equal(cloth, PAPERS_CLOTH)


def test_each_way_of_refinement_has_a_row_per_state(monkeypatch: pytest.MonkeyPatch, workplace: Path) -> None:
    module = study(monkeypatch, workplace, "refinement", str(COUNT))
    rows = pd.read_csv("reports/smoke/studies/refinement.csv")
    means = pd.read_csv("reports/smoke/studies/refinement_summary.csv")
    assert list(rows["way"].unique()) == list(module.ways(RefineConfig()))
    sizes = rows.groupby("way").size()
    assert (sizes == sizes.iloc[0]).all()
    assert sizes.iloc[0] >= COUNT
    assert (rows["milliseconds"] > 0).all()
    assert rows["silhouette"].between(0, 1).all()
    overall = rows.groupby("way")["error"].mean()
    for way, own in means.groupby("way"):
        weights = rows[rows["way"] == way].groupby("state").size()
        assert np.average(own["error"], weights=weights[own["state"]]) == pytest.approx(overall[way], abs=1e-4)
