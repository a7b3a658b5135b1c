"""The examples' agents, on small cloths and with nets that have learned nothing."""

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

import clothkit
import clothkit.environment
from clothkit.cloth.topology import SQUARE
from clothkit.goals.making import careful
from clothkit.simulation.settings import SimulationConfig
from tests.tiny import ROOT, write_nets, write_params

COARSE = SimulationConfig(side=8, grasp="all")
CAREFUL = careful(SimulationConfig(side=17, time_step=2e-3))


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"example_{name}", ROOT / f"examples/{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def made(**options: Any) -> Any:
    return gymnasium.make(clothkit.environment.ID, **options)


def test_a_random_agent_is_the_same_for_the_same_seed() -> None:
    goal = SQUARE.flat()[::4, ::4]
    errors = [example("random_agent").play(made(simulation=COARSE, goal=goal), episodes=2, seed=7) for _ in range(2)]
    assert errors[0] == errors[1]
    assert len(errors[0]) == 2


def test_a_scripted_agent_folds_by_the_goals_own_manipulations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    agent = example("scripted_agent")
    monkeypatch.setattr(agent, "user_folder", lambda: tmp_path)
    actions = agent.script("half", CAREFUL)
    env = made(simulation=CAREFUL, goal="half", goals_folder=tmp_path)
    total, error = agent.play(env, actions)
    # The same hands in the same world: the goal itself, but for rounding.
    assert error < 0.005
    assert total > 0.3


def test_a_clothkit_agent_has_its_plans_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_params(tmp_path / "params.yaml")
    write_nets(tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    agent = example("clothkit_agent")
    env = made(steps=1, observation="voxels", goal=folded())
    found, start = agent.play(env, clothkit.Agent("data"), seed=0)
    assert np.isfinite(found)
    assert start > 0.1


def test_a_plan_is_the_action_that_grasps_where_it_does(tmp_path: Path) -> None:
    """A plan for the flat cloth, 0.1 cloth lengths away, by hand."""
    from tests.app import plans

    plan = clothkit.Plan.model_validate(plans.content())
    at = np.array(plans.AT)
    action = example("clothkit_agent").action_of(plan, np.array([0.1, 0.0]))
    corners = (np.array([[0.2, -0.2], [0.2, 0.2]]) + at) / 0.4 + [0.1, 0]
    np.testing.assert_allclose(action, [*corners.ravel(), -1.3 / 1.4, 0], atol=1e-5)


def folded() -> np.ndarray:
    """Half of the cloth on the other half."""
    mesh = SQUARE.flat().copy()
    mesh[16:, :, 0] *= -1
    mesh[16:, :, 2] = 0.01
    return mesh
