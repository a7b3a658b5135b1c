"""`clothkit plan --steps auto`: as many manipulations as are worth it, none if the cloth is the goal already."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.app import plan as plan_command
from clothkit.app.agent import Agent
from clothkit.app.inputs import Settings, load_settings
from clothkit.app.lengths import choice_in_words
from clothkit.app.options import observation_options
from clothkit.app.output import write_mesh
from clothkit.app.plan_file import UNLIKELY, read_plan
from clothkit.cloth.topology import SQUARE
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.types import Choice
from tests.app.conftest import AT, run, succeed
from tests.app.test_plan import FOUND, toy_planner
from tests.observation.scenes import SCALE
from tests.planning import toy
from tests.planning.test_lengths import finding

FOLDS = np.concatenate([FOUND, [[-1, 1, -1, 1, 0.6, -0.5]]]).astype(np.float32)


@pytest.fixture
def goals(here: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """goal_0.obj .. goal_2.obj: what none, one and two folds make of the flat cloth in the toy world."""
    monkeypatch.setattr(plan_command, "load_planner", toy_planner)
    mesh = SQUARE.flat()
    for number in range(3):
        write_mesh(here / f"goal_{number}.obj", mesh.astype(float) * SCALE + [*AT, 0])
        mesh = np.asarray(toy.dragged(jnp.asarray(mesh), jnp.asarray(FOLDS[number])))
    return here


def test_as_many_steps_as_the_goal_takes(goals: Path) -> None:
    for number in (1, 2):
        with finding({n: FOLDS[:n] for n in (1, 2, 3)}):
            said = succeed("plan", "--state", "goal_0.obj", "--goal", f"goal_{number}.obj", "--steps", "auto")
        plan = read_plan(goals / "plan.json")
        np.testing.assert_allclose([step.manipulation for step in plan.steps], FOLDS[:number], atol=1e-6)
        assert plan.expected.improves
        assert "expected error by number of manipulations: 0: " in said
        assert said.count("(chosen)") == 1
        error = 1000 * (plan.expected.error_m or 0)
        assert f"{number}: {error:.0f} mm (chosen)" in said


def test_nothing_is_planned_for_a_goal_that_is_reached(goals: Path) -> None:
    with finding({n: FOLDS[:n] for n in (1, 2, 3)}):
        said = succeed("plan", "--state", "goal_1.obj", "--goal", "goal_1.obj", "--steps", "auto")
    plan = read_plan(goals / "plan.json")
    (step,) = plan.steps
    assert step.null
    assert not step.hands
    assert not plan.expected.improves
    assert plan.warning == UNLIKELY
    assert plan.expected.error_m == pytest.approx(0, abs=1e-6)
    assert "step 1: nothing to do" in said
    assert "0: 0 mm (chosen)" in said
    assert "nothing more is worth doing" in said


def test_after_a_plan_of_one_step_there_may_be_more(goals: Path) -> None:
    wanted = ("plan", "--state", "goal_1.obj", "--goal", "goal_2.obj", "--after", "plan.json", "--out", "rest.json")
    with finding({1: FOLDS[:1], 2: FOLDS[:2], 3: FOLDS}):
        succeed("plan", "--state", "goal_0.obj", "--goal", "goal_1.obj", "--steps", "1")
        told = run(*wanted)
    assert told.exit_code == 1
    assert "nothing is left to plan" in told.output
    with finding({1: FOLDS[1:2], 2: FOLDS[1:], 3: FOLDS}):
        succeed(*wanted, "--steps", "auto")
    rest = read_plan(goals / "rest.json")
    np.testing.assert_allclose([step.manipulation for step in rest.steps], FOLDS[1:2], atol=1e-6)


@pytest.mark.parametrize("told", ["0", "4", "many", "1.5"])
def test_what_a_number_of_steps_may_be(here: Path, told: str) -> None:
    result = run("plan", "--state", "start.obj", "--goal", "half", "--steps", told)
    assert result.exit_code == 2
    assert f"expected 1 to 3 or auto, found {told}" in result.output


def test_systems_in_voxels_do_not_choose(here: Path, files: Path) -> None:
    result = run(
        "plan", "--state", files / "voxels.npy", "--goal", files / "voxels.npy", "--steps", "auto", "--system", "b4"
    )
    assert result.exit_code == 1
    assert "--steps auto: system b4 plans in voxels" in result.output


def test_numbers_without_a_plan_are_left_out() -> None:
    choice = Choice(np.array([2]), np.array([[0.2, np.inf, 0.05, np.inf]]))
    assert choice_in_words(choice, 0.5) == "expected error by number of manipulations: 0: 100 mm, 2: 25 mm (chosen)"


def test_nothing_is_done_where_such_plans_made_things_worse(goals: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Such plans ended nine cloth lengths from their goals, whatever was expected of them.
    bad = ErrorMap(("expected",), np.ones(1), np.log(np.full(3, 9.0)), np.zeros(1), np.ones(1), np.ones((1, 3)))
    monkeypatch.setattr(Settings, "trust_in", lambda *_: bad)
    with finding({n: FOLDS[:n] for n in (1, 2, 3)}):
        said = succeed("plan", "--state", "goal_0.obj", "--goal", "goal_2.obj", "--steps", "auto")
    plan = read_plan(goals / "plan.json")
    assert [step.null for step in plan.steps] == [True]
    assert plan.warning == UNLIKELY
    assert plan.expected.error_m == plan.expected.error_no_action_m
    assert plan.expected.silhouette_iou == plan.expected.silhouette_iou_no_action
    assert "nothing more is worth doing: plans with such expectations ended farther" in said


def test_a_loop_ends_where_nothing_more_is_worth_doing(goals: Path) -> None:
    """The loop of docs/robots.md, with a goal that is one fold away."""
    settings = load_settings(Path("data"))
    agent = Agent.of(toy_planner(), settings, observation_options(settings.app, side=None, table=None))
    agent.begin("goal_1.obj", steps="auto")
    files, improved = ["goal_0.obj", "goal_1.obj"], []
    with finding({n: FOLDS[:n] for n in (1, 2, 3)}):
        while agent.left:
            agent.observe(files[len(improved)])
            improved.append(agent.plan().expected.improves)
    assert improved == [True, False]
    # What is left undone stays over.
    agent.observe("goal_1.obj")
    assert agent.left == 0
