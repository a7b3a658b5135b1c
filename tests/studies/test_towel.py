"""The study of a towel: how its goals come about, with which settings it plans, and what its table says."""

import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import pytest

from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.runtime.errors import InputError
from clothkit.simulation.material import FABRICS
from clothkit.simulation.settings import DRAWN, SimulationConfig
from tests import tiny
from tests.app.plans import finding
from tests.planning import toy

SIDES = (0.5, 0.3)
PLAN = np.array([[-1, -1, -1, 1, 0.5, 0.0], [-1, -1, 0, -1, 0.0, 0.3]], np.float32)


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "studies"))
    import towel

    return towel


def in_the_toy_world(meshes: np.ndarray, *how: Any, settings: Any = None, workers: int = 0, **other: Any) -> np.ndarray:
    """In place of the simulator."""
    return toy.execute(meshes, *how)


def test_goals_are_folds_of_a_towel_of_that_size(study: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[np.ndarray, ...]] = []

    def execute(meshes: np.ndarray, *how: Any, settings: SimulationConfig) -> np.ndarray:
        calls.append((meshes, *how))
        return meshes

    monkeypatch.setattr(study, "execute", execute)
    dataset = study.towels(3, SIDES, 0.005, SimulationConfig())
    np.testing.assert_allclose(dataset.cloth, np.tile([1.4, 0.84, 0.014], (3, 1)), rtol=1e-6)
    (flat, grasped, moves, _, cloths), (_, grasped_again, moves_again, _, _) = calls
    scale = CLOTH_LENGTH / 0.5
    # Whatever the angle, hands take the corners of a short side, 0.3 m apart, and go 0.89 of the long side inwards.
    np.testing.assert_allclose(np.linalg.norm(grasped[:, 0] - grasped[:, 1], axis=-1), 0.3 * scale, rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(moves, axis=-1), 0.89 * 0.5 * scale, rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(grasped.mean(1) + moves, axis=-1), (0.89 - 0.5) * 0.5 * scale, rtol=1e-5)
    # Then along a long side, from its end to its middle, and across it.
    np.testing.assert_allclose(
        np.linalg.norm(grasped_again[:, 0] - grasped_again[:, 1], axis=-1), 0.25 * scale, rtol=0.05
    )
    np.testing.assert_allclose(np.linalg.norm(moves_again, axis=-1), 0.89 * 0.3 * scale, rtol=1e-5)
    np.testing.assert_allclose((moves * moves_again).sum(-1), 0, atol=1e-6)
    assert (flat[..., 2] == np.float32(0.007)).all()
    # On the simulator's 0.4 m it is as much thinner, and softer by the third power.
    material = dict(zip(DRAWN, cloths.material[0], strict=True))
    assert material["thickness"] == pytest.approx(0.004, rel=1e-5)
    assert material["bending_stiffness"] == pytest.approx(FABRICS["towel"].bending_stiffness * 0.8**3, rel=1e-5)


def test_settings_are_those_of_the_nets_scale(study: ModuleType, tmp_path: Path) -> None:
    tiny.write_params(tmp_path / "params.yaml")
    tiny.write_nets(tmp_path / "data")
    assert study.params_of(Path("data")).scale == "smoke"
    path = tmp_path / "data/nets/vtm/net.json"
    about = json.loads(path.read_text())
    path.write_text(json.dumps({**about, "scale": "household"}))
    params = study.params_of(Path("data"))
    assert params.stages == study.load_params(Path("params.yaml")).scales["household"]
    path.write_text(json.dumps({**about, "scale": "huge"}))
    with pytest.raises(InputError, match=r"was made at scale huge, of which params\.yaml has no block"):
        study.params_of(Path("data"))


def test_each_repeat_has_a_row_of_each_task(
    study: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny.write_params(tmp_path / "params.yaml")
    tiny.write_nets(tmp_path / "data")
    monkeypatch.setattr(study, "execute", in_the_toy_world)
    monkeypatch.setattr(study, "make_simulator", lambda settings: in_the_toy_world)
    monkeypatch.setattr(sys, "argv", ["towel", "2", "--sides", "0.4", "0.4"])
    with finding(PLAN):
        study.main()
    rows = pd.read_csv("reports/smoke/studies/towel.csv")
    tasks = rows.groupby("repeat", sort=False)["task"].agg(list).to_dict()
    assert tasks == {repeat: ["half", "half to quarter", "quarter"] for repeat in (0, 1)}
    assert rows.notna().all(axis=None)
    assert (rows["error_no_action"] > 0.05).all()
    assert rows["iou"].between(0, 1).all()
    found = study.summary(rows).set_index("task")
    for task, own in rows.groupby("task"):
        assert found.loc[task, "error"] == pytest.approx(own["error"].mean())
        assert found.loc[task, "repeats"] == 2
    assert "half to quarter" in capsys.readouterr().out
