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
from clothkit.app import named_goals
from clothkit.app.inputs import load_settings
from clothkit.app.observables import input_of
from clothkit.app.options import observation_options
from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import VIEWPORT, Viewport
from clothkit.goals import store
from clothkit.goals.making import careful
from clothkit.observation.states import VoxelState
from clothkit.simulation.settings import SimulationConfig
from tests.app.plans import finding
from tests.goals.test_variants import exact
from tests.tiny import ROOT, write_nets, write_params

COARSE = SimulationConfig(side=8, grasp="all")
CAREFUL = careful(SimulationConfig(side=17, time_step=2e-3))
TALL = Viewport(height=0.4, curve=2.0)


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


def test_more_manipulations_than_are_planned_at_once_are_planned_in_several_sessions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_params(tmp_path / "params.yaml")
    write_nets(tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(store, "make", lambda goal, topology, simulation: exact(goal.name, topology))
    monkeypatch.setattr(named_goals, "user_folder", lambda: tmp_path)
    begun = []

    class Noted(clothkit.Agent):
        def begin(self, goal: Any, steps: Any = None, **options: Any) -> clothkit.Agent:
            found = super().begin(goal, steps, **options)
            begun.append((goal, steps, self.state.target))
            return found

    env = made(simulation=COARSE, observation="voxels", goal="corners-in", goals_folder=tmp_path)
    with finding(np.array([[-1, -1, -1, -1, 0.6, 0.5]] * 3, np.float32)):
        agent = Noted("data")
        found, start = example("clothkit_agent").play(env, agent, seed=0)
    assert np.isfinite([found, start]).all()
    # The goal needs four manipulations, and there is one more.
    (goal, steps, _), (again, rest, target) = begun
    assert (goal, steps, rest) == ("corners-in", 3, 2)
    # The cloth lies folded by then: the goal is laid as it was, and not as that cloth lies.
    np.testing.assert_array_equal(target, again.state.mesh)
    assert again.file == "corners-in"
    assert env.unwrapped._left == 0
    with pytest.raises(clothkit.InputError, match="another viewport than the environment's"):
        example("clothkit_agent").play(made(observation="voxels", goal=folded(), viewport=TALL), agent, seed=0)


def test_heights_come_back_if_the_environment_has_the_viewport_of_the_agents_nets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_params(tmp_path / "params.yaml")
    write_nets(tmp_path / "data", viewport=TALL)
    monkeypatch.chdir(tmp_path)
    agent = clothkit.Agent("data")
    assert agent.viewport == TALL
    step = COARSE.topology.flat()
    step[:4, :, 2], step[4:, :, 2] = 0.02, 0.3
    env = made(simulation=COARSE, observation="voxels", goal=step, start=step, viewport=agent.viewport)
    seen, _ = env.reset(seed=0)
    options = observation_options(load_settings(Path("data")).app, side=None)
    for part in ("cloth", "goal"):
        points = input_of(seen[part].astype(bool), options, name=part).observation.points
        # Voxels are 0.01 high at the one height, 0.04 at the other.
        assert np.median(points[points[:, 0] < -0.2, 2]) == pytest.approx(0.02, abs=0.006)
        assert np.median(points[points[:, 0] > 0.2, 2]) == pytest.approx(0.3, abs=0.022)
    with pytest.raises(
        clothkit.InputError, match=r"goal: holds voxels of a viewport with height 0.125 and curve 1, exp"
    ):
        agent.begin(VoxelState(seen["goal"].astype(bool), viewport=VIEWPORT), steps=1)


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
