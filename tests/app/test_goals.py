"""Named goals through the command line: listed, pictured, planned for, and held against what came of it."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from clothkit.app import goals as goals_command
from clothkit.app import named_goals
from clothkit.app.agent import Agent
from clothkit.app.plan_file import read_plan
from clothkit.cloth.mesh import error
from clothkit.cloth.topology import SQUARE, rectangle
from clothkit.dataset.store import STEPS
from clothkit.goals import store
from clothkit.goals.making import Made
from clothkit.goals.variants import Variant, lay, placed
from clothkit.manipulation.named_folds import GOALS, Goal
from clothkit.observation.files import read
from clothkit.runtime.errors import InputError
from tests.app.conftest import run, succeed
from tests.app.plans import finding
from tests.goals.test_variants import exact
from tests.observation.scenes import SCALE

FOUND = np.array([[-1, -1, 1, -1, 0.1, 0.7], [0.5, 1, 0.5, 1, -0.6, -0.4], [1, 1, 1, 1, -0.6, -0.4]], np.float32)
ANGLE = 0.3


@pytest.fixture(autouse=True)
def kept(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Goals are folded exactly here, and kept for the test alone; the names of those that were made."""
    folder, names = tmp_path_factory.mktemp("goals"), []

    def make(goal: Goal, topology: object, simulation: object) -> Made:
        names.append(goal.name)
        if goal.name == "eighth":
            raise InputError("goal eighth, fold 3: no try left this cloth clean (intersections)")
        made = exact(goal.name, topology)
        hands = np.array([[-1, -1, -1, 1, 1.2, 0]], np.float32)
        return made._replace(manipulations=np.repeat(hands, len(made.manipulations), axis=0))

    monkeypatch.setattr(store, "make", make)
    # In this process, where it is replaced.
    monkeypatch.setattr(store, "cores", lambda: 1)
    for module in (goals_command, named_goals):
        monkeypatch.setattr(module, "user_folder", lambda: folder)
    return names


@pytest.fixture
def start(here: Path) -> Path:
    """The flat cloth, turned on the table."""
    np.save(here / "start.npy", lay(SQUARE.flat(), ANGLE))
    return here / "start.npy"


def test_names_are_listed_at_once(kept: list[str]) -> None:
    lines = succeed("goals", "--list").splitlines()
    assert [line.split()[:2] for line in lines] == [[name, str(goal.manipulations)] for name, goal in GOALS.items()]
    assert "Foldsformer double straight" in next(line for line in lines if line.startswith("quarter"))
    assert succeed("goals", "--list", "half").count("\n") == 1
    assert kept == []


def test_pictures_and_meshes_of_ones_own_cloth(here: Path, kept: list[str]) -> None:
    asked = ("goals", "half", "corners-in", "--sides", 0.5, 0.25, "--meshes", "towel", "--out", "towel.png")
    said = succeed(*asked)
    assert "towel.png: 2 goals" in said
    picture = cv2.imread(str(here / "towel.png"))
    assert picture is not None
    # Five states of the one with four folds beside two of the other.
    assert picture.shape[1] > picture.shape[0]
    assert sorted(path.name for path in (here / "towel").iterdir()) == ["corners-in.obj", "half.obj"]
    half = read(here / "towel/half.obj", cloth_side=0.5, topology=rectangle(2.0)).mesh
    np.testing.assert_allclose(np.ptp(half[..., :2], axis=(0, 1)), [0.7, 0.7], atol=0.03)
    succeed(*asked, "--format", "ply")
    assert kept == ["half", "corners-in"]


def test_a_fold_from_another_side(here: Path) -> None:
    succeed("goals", "half", "--turn", 90, "--meshes", "turned")
    turned = read(here / "turned/half.obj").mesh
    np.testing.assert_allclose(np.ptp(turned[..., :2], axis=(0, 1)), [1.4, 0.7], atol=0.03)


def test_what_can_not_be_made_is_told_and_the_rest_shown(here: Path) -> None:
    said = succeed("goals", "half", "eighth")
    assert "not of this cloth: goal eighth, fold 3: no try left this cloth clean" in said
    assert "goals.png: 1 goal" in said
    result = run("goals", "eighth")
    assert result.exit_code == 1
    assert result.stderr.splitlines()[-1] == "goals: goal eighth, fold 3: no try left this cloth clean (intersections)"


@pytest.mark.parametrize("system", ["b1", "main"])
def test_a_plan_for_a_name_has_its_steps_and_lies_as_the_cloth_lies(start: Path, here: Path, system: str) -> None:
    with finding(FOUND):
        succeed("plan", "--state", start, "--goal", "quarter", "--system", system)
    plan = read_plan(here / "plan.json")
    assert len(plan.steps) == GOALS["quarter"].manipulations
    assert (plan.goal.file, plan.goal.kind, plan.goal.taken) == ("quarter", "mesh", "as it is")
    assert plan.goal.named is not None
    # The file is a mesh, which tells how the cloth lies for each system.
    assert plan.goal.named.angle_rad == pytest.approx(ANGLE, abs=1e-3)
    assert plan.state.named is None


def test_a_cloud_tells_how_the_cloth_lies(here: Path, files: Path) -> None:
    with finding(FOUND):
        succeed("plan", "--state", files / "cloud.npz", "--goal", "half", "--turn", 180, "--mirror")
    plan = read_plan(here / "plan.json")
    assert plan.goal.named is not None
    assert (plan.goal.named.turn_deg, plan.goal.named.mirror) == (180, True)
    assert abs(plan.goal.named.angle_rad) <= np.pi / 4


def test_a_goal_of_more_manipulations_than_a_plan_has_is_told(start: Path, here: Path) -> None:
    with finding(FOUND):
        result = run("plan", "--state", start, "--goal", "corners-in")
        assert result.exit_code == 0
        assert "notice: corners-in needs 4 manipulations, and a plan has at most 3" in result.stderr
        assert len(read_plan(here / "plan.json").steps) == STEPS
        succeed("plan", "--state", start, "--goal", "corners-in", "--steps", 1)
    assert len(read_plan(here / "plan.json").steps) == 1


def test_what_follows_a_plan_keeps_its_goal(start: Path, here: Path) -> None:
    with finding(FOUND):
        succeed("plan", "--state", start, "--goal", "quarter", "--turn", 90)
        # Half folded and turned by the hands: how it lies now says nothing.
        np.save(here / "later.npy", lay(exact("half", SQUARE).states[1], 1.1))
        succeed("plan", "--state", "later.npy", "--goal", "quarter", "--after", "plan.json", "--out", "rest.json")
        first, rest = (read_plan(here / name) for name in ("plan.json", "rest.json"))
        assert rest.goal == first.goal
        assert len(rest.steps) == 1
        for asked, sentence in (
            (("--goal", "thirds"), "--goal: expected quarter, for which plan.json was planned, found thirds"),
            (("--goal", "quarter", "--turn", 0), "--turn: expected 90, for which plan.json was planned, found 0"),
            (("--goal", "quarter", "--mirror"), "--mirror: plan.json was planned for a goal that is not mirrored"),
        ):
            result = run("plan", "--state", "later.npy", "--after", "plan.json", "--out", "rest.json", *asked)
            assert result.exit_code == 1
            assert result.stderr.splitlines()[-1] == f"plan: {sentence}"


def test_an_agent_lays_a_named_goal_as_the_cloth_lies_that_it_first_observes(start: Path, here: Path) -> None:
    goal = placed(exact("quarter", SQUARE), Variant(turn=90, angle=ANGLE))
    agent = Agent("data", system="b1").begin("quarter", turn=90)
    assert agent.left == 2
    other = agent.copy()
    agent.observe(start)
    np.testing.assert_allclose(agent.state.target, goal, atol=1e-3)
    np.testing.assert_array_equal(agent.session.goal, agent.state.target)
    with finding(FOUND[:2]):
        plan = agent.plan()
    assert plan.goal.named is not None
    assert (plan.goal.file, plan.goal.named.turn_deg) == ("quarter", 90)
    assert plan.goal.named.angle_rad == pytest.approx(ANGLE, abs=1e-3)
    # It stays, however the cloth lies later, and for who goes on from a plan.
    np.save("later.npy", SQUARE.flat())
    again = Agent("data", system="b1").begin("quarter", after=plan)
    for later in (agent, again):
        later.observe("later.npy")
        assert later.left == 1
        np.testing.assert_allclose(later.state.target, goal, atol=1e-3)
    # The copy has seen nothing yet.
    other.observe("later.npy")
    np.testing.assert_allclose(other.state.target, placed(exact("quarter", SQUARE), Variant(turn=90)), atol=1e-3)
    for wrong, options, says in (
        ("halve", {"steps": 1}, "expected a file or one of half, triangle"),
        (0.3 * SQUARE.flat(), {"steps": 1, "turn": 90}, "--turn: is for named goals, but the goal is given as arrays"),
        ("thirds", {"after": plan}, "--goal: expected quarter, for which the plan before was planned, found thirds"),
        ("quarter", {"after": plan, "steps": 2}, "--steps: expected 1, what is left of the plan before, found 2"),
    ):
        with pytest.raises(InputError, match=says):
            other.begin(wrong, **options)


def test_an_outcome_is_held_against_the_goal_that_was_planned_for(
    start: Path, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with finding(FOUND):
        succeed("plan", "--state", start, "--goal", "half")
    from clothkit.app import simulate

    goal = placed(exact("half", SQUARE), Variant(angle=ANGLE))
    monkeypatch.setattr(simulate, "execute", lambda *_, **__: goal[None])
    said = succeed("simulate", "--plan", "plan.json", "--goal", "half", "--out", "outcome.obj")
    assert "error 0 mm" in said
    assert "silhouette IoU 1.00" in said or "silhouette IoU 0.99" in said
    outcome = read(here / "outcome.obj").mesh
    assert float(error(outcome, goal, aligned=True)) < 1e-3
    result = run("simulate", "--plan", "plan.json", "--goal", "thirds", "--out", "outcome.obj")
    assert result.stderr.splitlines()[-1] == (
        "simulate: --goal: expected half, for which plan.json was planned, found thirds"
    )


def test_a_name_wins_over_a_file_of_that_name_and_says_so(start: Path, here: Path) -> None:
    (here / "half").touch()
    with finding(FOUND):
        result = run("plan", "--state", start, "--goal", "half")
    assert result.exit_code == 0
    assert "notice: --goal half: the named goal is meant, and not the file ./half" in result.stderr


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        (("--goal", "halve", "--steps", 1), "--goal: expected a file or one of half, triangle, thirds"),
        (("--goal", "goal.glb", "--steps", 1, "--turn", 90), "--turn: is for named goals, but the goal is goal.glb"),
        (("--goal", "goal.glb", "--steps", 1, "--mirror"), "--mirror: is for named goals, but the goal is goal.glb"),
        (("--goal", "eighth"), "goal eighth, fold 3: no try left this cloth clean"),
    ],
)
def test_bad_goals_end_in_one_sentence(start: Path, asked: tuple[object, ...], sentence: str) -> None:
    result = run("plan", "--state", start, *asked)
    assert result.exit_code == 1
    assert result.stderr.splitlines()[-1].startswith(f"plan: {sentence}")


def test_metres_are_those_of_the_cloth(here: Path) -> None:
    succeed("goals", "half", "--side", 0.8, "--meshes", "large")
    (line, *_) = [line for line in (here / "large/half.obj").read_text().splitlines() if line.startswith("v ")]
    assert np.abs(np.array(line.split()[1:], float)).max() <= 0.8 / 2 + 1e-6
    assert read(here / "large/half.obj", cloth_side=0.8).scale == pytest.approx(2 * SCALE)
