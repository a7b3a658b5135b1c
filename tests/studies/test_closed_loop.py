"""The study of closed loops: when a session ends and what it tells, by hand, in the toy world; then a session of it."""

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import clothkit
from clothkit.app import named_goals
from clothkit.cloth.mesh import error
from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import SQUARE
from clothkit.goals import store
from clothkit.goals.settings import EvaluateGoalsConfig
from clothkit.goals.starts import Laid, cloth_of
from clothkit.simulation.settings import SimulationConfig
from tests.app import plans
from tests.app.test_agent import metres, toy_agent
from tests.app.test_plan import FOUND, toy_planner
from tests.goals.test_variants import exact
from tests.planning import toy
from tests.planning.test_lengths import finding
from tests.tiny import ROOT, write_nets, write_params

FOLD = np.concatenate([FOUND[:1], FOUND[:1], FOUND[:1]])


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    monkeypatch.syspath_prepend(ROOT / "studies")
    monkeypatch.chdir(tmp_path)
    return import_module("closed_loop")


def folded(mesh: np.ndarray, *_: Any) -> np.ndarray:
    return np.asarray(toy.dragged(jnp.asarray(mesh), jnp.asarray(FOUND[0])))


def see(mesh: np.ndarray) -> tuple[np.ndarray, None]:
    return metres(mesh), None


def test_a_session_ends_when_nothing_more_is_worth_doing(study: ModuleType, tmp_path: Path) -> None:
    flat = SQUARE.flat()
    agent = toy_agent(planner=toy_planner()).begin(metres(folded(flat)), steps="auto")
    with finding({n: FOLD[:n] for n in (1, 2, 3)}):
        looks = study.play(agent, flat, see, folded)
    first, last = (look.row for look in looks)
    assert (first["end"], last["end"]) == ("", study.DONE)
    by_hand = float(error(flat, centred(folded(flat))[0], aligned=True))
    assert first["error"] == pytest.approx(by_hand, abs=1e-5)
    assert first["estimated"] == pytest.approx(by_hand, abs=1e-5)
    assert first["expected"] == pytest.approx(0, abs=1e-4)
    assert (first["steps"], last["steps"]) == (1, 0)
    assert last["error"] == pytest.approx(0, abs=1e-4)
    assert last["iou"] == pytest.approx(1, abs=0.01)
    assert first["iou"] < 0.95
    np.testing.assert_allclose(looks[0].plan.manipulations, FOUND[:1])
    np.testing.assert_allclose(looks[1].mesh, folded(flat), atol=1e-6)
    study.picture(looks, agent.state.target, "one fold", tmp_path / "session.png")
    assert cv2.imread(str(tmp_path / "session.png")).std() > 5


def test_a_session_ends_when_its_manipulations_are_used_up_or_the_cloth_is_refused(study: ModuleType) -> None:
    flat = SQUARE.flat()
    agent = toy_agent(planner=toy_planner()).begin(metres(folded(flat)), steps=1)
    with finding({1: FOLD[:1]}):
        looks = study.play(agent, flat, see, folded)
    assert [look.row["end"] for look in looks] == ["", study.USED_UP]
    assert looks[1].plan is None
    agent.begin(metres(folded(flat)), steps=1)
    (look,) = study.play(agent, flat, lambda mesh: (metres(mesh) * np.nan, None), folded)
    assert "vertices that are not finite" in look.row["end"]
    assert look.voxels is None


def test_the_camera_sees_the_upper_side_and_hands_grasp_in_metres(
    study: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    moved = SQUARE.flat() + np.float32([0.2, -0.1, 0])
    points, mask = study.camera_above(0.5, 0.01, seed=0)(moved)
    scale = 0.5 / 1.4
    # The camera's y points the other way, and it is 0.9 m above the table.
    expected = [0.2 * scale, 0.1 * scale, 0.9 - 0.005]
    np.testing.assert_allclose(points[mask].mean(0), expected, atol=0.003)
    drawn = cloth_of(0, EvaluateGoalsConfig(), study.world_of((0.5, 0.3), 0.005, SimulationConfig()))
    assert drawn.topology.sides == pytest.approx((1.4, 1.4 * 0.3 / 0.5))
    assert drawn.simulation.material.thickness == pytest.approx(0.005 * 0.4 / 0.5)
    given: list[Any] = []
    monkeypatch.setattr(study, "execute", lambda *parts, **_: given.append(parts) or parts[0])
    plan = clothkit.Plan.model_validate(plans.content())
    study.hands_in(drawn)(moved, plan)
    ((meshes, grasps, displacement, single, cloths),) = given
    np.testing.assert_array_equal(meshes, moved[None])
    # The corners at u = 1 of a flat cloth of 0.4 m that lies where `plans` says.
    corners = (np.array([[0.2, -0.2], [0.2, 0.2]]) + np.array(plans.AT)) / 0.4 * 1.4
    np.testing.assert_allclose(grasps[0], corners, atol=1e-5)
    np.testing.assert_allclose(displacement, [[-1.3, 0]], atol=1e-6)
    assert not single[0]
    assert cloths.cloth[0, 2] == pytest.approx(0.005 * 1.4 / 0.5)


def test_a_session_before_the_camera(study: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Of nets that have learned nothing it is asked that rows and pictures come about, of the cloth that was told."""
    write_params(tmp_path / "params.yaml")
    write_nets(tmp_path / "data")
    monkeypatch.setattr(store, "make", lambda goal, topology, simulation: exact(goal.name, topology))
    monkeypatch.setattr(named_goals, "user_folder", lambda: tmp_path)
    monkeypatch.setattr(study, "start_of", lambda repeat, name, settings, world: Laid(SQUARE.flat()))
    monkeypatch.setattr(study, "execute", lambda meshes, *_, **__: meshes)
    told = ["1", "--goal", "quarter", "--starts", "flat", "--sides", "0.4", "0.4", "--data", "data"]
    monkeypatch.setattr(sys, "argv", ["closed_loop", *told])
    with finding({n: FOLD[:n] for n in (1, 2, 3)}):
        study.main()
    table = pd.read_csv("reports/smoke/studies/closed_loop.csv")
    assert tuple(table.columns) == study.COLUMNS
    assert table["end"].notna().tolist() == [False] * (len(table) - 1) + [True]
    assert table["error"].notna().all()
    assert (table["goal"] == "quarter").all()
    assert cv2.imread("reports/smoke/studies/closed_loop/flat_0.png") is not None
