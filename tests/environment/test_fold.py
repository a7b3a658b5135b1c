"""The environment: its library's own checker; rewards, observations and manipulations against other computations."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env

import clothkit.environment
from clothkit.cloth import voxels
from clothkit.cloth.mesh import error
from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import Topology, square
from clothkit.environment.fold import FoldEnv
from clothkit.goals import store
from clothkit.goals.making import Made
from clothkit.goals.measures import softgym
from clothkit.goals.variants import lay
from clothkit.manipulation.named_folds import GOALS, Goal
from clothkit.observation.camera import CameraConfig, DepthImage, back_project
from clothkit.runtime.errors import InputError
from clothkit.simulation.executor import execute
from clothkit.simulation.settings import SimulationConfig
from tests.goals.test_variants import exact

COARSE = SimulationConfig(side=8)
"""A cloth that is simulated in no time."""
CAMERA = CameraConfig(columns=40, rows=30, focal=37.0)
FLAT = COARSE.topology.flat()
SQUARE_12 = square(12).flat()
HALF = np.array([1, -1, 1, 1, -0.95, 0], np.float32)
"""Both corners of one edge to the opposite edge."""
SHORT = np.array([1, -1, 1, 1, -0.3, 0.1], np.float32)


def made(**options: Any) -> FoldEnv:
    found = gymnasium.make(
        clothkit.environment.ID, **{"simulation": COARSE, "camera": CAMERA, "goal": folded(), **options}
    )
    env = found.unwrapped
    assert isinstance(env, FoldEnv)
    return env


def folded(mesh: np.ndarray = FLAT, action: np.ndarray = HALF) -> np.ndarray:
    """What the executor makes of two-handed manipulations at the cloth's corners."""
    grasps = np.array([[mesh[-1, 0, :2], mesh[-1, -1, :2]]])
    displacement = (1.4 * action[None, 4:].astype(float)).astype(np.float32)
    return execute(mesh[None], grasps, displacement, np.array([False]), settings=COARSE, workers=1)[0]


@pytest.fixture
def exactly(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Goals are folded exactly instead of in the simulator; the folder in which they are kept."""

    def make(goal: Goal, topology: Topology, simulation: object) -> Made:
        return exact(goal.name, topology)

    monkeypatch.setattr(store, "make", make)
    return tmp_path


@pytest.mark.parametrize("kind", ["vertices", "voxels", "depth"])
def test_the_librarys_checker_finds_nothing(kind: str, exactly: Path) -> None:
    """Warnings are errors here, and so are those of the checker."""
    check_env(made(observation=kind, goal="half", goals_folder=exactly))


def test_the_reward_is_the_decrease_of_the_error_and_the_goal_ends_an_episode() -> None:
    env = made(steps=3)
    first, info = env.reset(seed=0)
    start = float(error(FLAT, centred(folded())[0], aligned=True, topology=COARSE.topology))
    assert info["error"] == info["error_start"] == pytest.approx(start, abs=1e-6)
    assert first["left"] == [3]
    again, reward, terminated, truncated, info = env.step(SHORT)
    assert info["null"]
    assert (reward, terminated, truncated) == (0, False, False)
    np.testing.assert_array_equal(again["cloth"], first["cloth"])
    last, reward, terminated, truncated, info = env.step(HALF)
    assert reward == pytest.approx(start, abs=1e-5)
    assert info["error"] == pytest.approx(0, abs=1e-5)
    assert info["is_success"]
    assert terminated
    assert not truncated
    np.testing.assert_allclose(last["cloth"] * 1.4, folded(), atol=1e-5)
    np.testing.assert_allclose(last["goal"] * 1.4, centred(folded())[0], atol=1e-5)
    env.step(SHORT)
    with pytest.raises(InputError, match="no manipulation is left"):
        env.step(SHORT)


def test_an_episode_is_truncated_when_its_manipulations_are_used_up() -> None:
    env = made(steps=1)
    env.reset()
    assert env.step(SHORT)[2:4] == (False, True)


def test_another_measure_is_the_reward() -> None:
    env = made(measure=lambda mesh, goal: float(np.ptp(mesh[..., 0])))
    env.reset()
    _, reward, terminated, _, info = env.step(HALF)
    width = float(np.ptp(folded()[..., 0]))
    assert reward == pytest.approx(1.4 - width, abs=1e-5)
    assert info["measure_start"] == pytest.approx(1.4)
    assert info["measure"] == pytest.approx(width, abs=1e-5)
    # The error ends an episode, whatever the reward is.
    assert terminated
    assert info["error"] == pytest.approx(0, abs=1e-5)


def test_named_goals_have_the_measure_of_softgym(exactly: Path) -> None:
    """The flat cloth lies turned, beside the middle of the table, and the goal is turned with it."""
    angle, away = 0.3, np.float32([0.4, 0, 0])
    env = made(goal="half", start=lay(FLAT, angle) + away, goals_folder=exactly)
    seen, info = env.reset(seed=0)
    assert (info["goal_name"], seen["left"].tolist()) == ("half", [2])
    assert (
        float(
            error(
                env.goal, lay(exact("half", COARSE.topology).states[-1], angle), aligned=True, topology=COARSE.topology
            )
        )
        < 0.01
    )
    folds = GOALS["half"].folds(COARSE.topology)
    assert info["measure"] == pytest.approx(softgym(FLAT, FLAT, COARSE.topology, folds), abs=1e-3)
    # The goal's own hands, turned as the cloth is.
    move = np.array([-1, -1, -1, 1, 0.95 * np.cos(angle), 0.95 * np.sin(angle)], np.float32)
    _, reward, _, _, info = env.step(move)
    before = lay(FLAT, angle) + away
    by_hand = softgym(env.mesh, before, COARSE.topology, folds)
    assert info["measure"] == pytest.approx(by_hand, abs=1e-3)
    assert reward == pytest.approx(info["measure_start"] - info["measure"])
    assert reward > 0.3


def test_one_of_several_goals_is_drawn_and_the_error_may_be_the_reward(exactly: Path) -> None:
    env = made(goal=("half", "quarter"), start="flat", measure="error", goals_folder=exactly)
    names = set()
    for seed in range(6):
        seen, info = env.reset(seed=seed)
        assert seen["left"] == [3]
        assert info["measure"] == info["error"]
        names.add(info["goal_name"])
        again, other = env.reset(seed=seed)
        assert other["goal_name"] == info["goal_name"]
        np.testing.assert_array_equal(again["cloth"], seen["cloth"])
        np.testing.assert_array_equal(again["goal"], seen["goal"])
    assert names == {"half", "quarter"}


def test_starts_by_name_lie_at_random() -> None:
    """As those of stage evaluate_goals: clean, at some angle; a dropped cloth is no flat one."""
    env = made(start="crumpled", simulation=SimulationConfig(side=12, time_step=2e-3), goal=SQUARE_12, steps=1)
    first, _ = env.reset(seed=0)
    second, _ = env.reset(seed=1)
    assert (first["cloth"] != second["cloth"]).any()
    assert np.isfinite(first["cloth"]).all()
    assert np.ptp(first["cloth"][..., 2]) > 0.05


def test_grasp_points_on_the_cloth_and_on_the_table_below_it_are_the_same() -> None:
    start = FLAT + np.float32([0.2, -0.1, 0])
    on_cloth = made(start=start)
    on_cloth.reset()
    on_cloth.step(HALF)
    on_table = made(start=start, grasps="table")
    on_table.reset()
    on_table.step(np.array([*start[-1, 0, :2] / 1.4, *start[-1, -1, :2] / 1.4, *HALF[4:]], np.float32))
    np.testing.assert_allclose(on_table.mesh, on_cloth.mesh, atol=1e-6)
    np.testing.assert_allclose(on_cloth.mesh, folded(start), atol=1e-5)


def test_two_equal_points_are_one_hand() -> None:
    env = made()
    env.reset()
    env.step(np.array([1, 1, 1, 1, -0.6, -0.6], np.float32))
    grasps = np.tile(FLAT[-1, -1, :2], (1, 2, 1))
    displacement = (1.4 * np.float32([[-0.6, -0.6]]).astype(float)).astype(np.float32)
    one = execute(FLAT[None], grasps, displacement, np.array([True]), settings=COARSE, workers=1)[0]
    np.testing.assert_allclose(env.mesh, one, atol=1e-6)


def test_observations_show_the_cloth_where_it_lies() -> None:
    start = FLAT + np.float32([0.28, -0.14, 0])
    seen = made(start=start, observation="voxels").reset()[0]
    np.testing.assert_array_equal(seen["cloth"], voxels.observe(centred(start)[0]))
    np.testing.assert_allclose(seen["centre"], [0.2, -0.1], atol=0.01)
    assert "goal_centre" not in seen
    env = made(start=start, observation="depth")
    seen = env.reset()[0]
    assert env.observation_space.contains(seen)
    cloud = back_project(DepthImage(seen["cloth"].astype(float), seen["mask"].astype(bool), CAMERA))
    assert cloud.cloth is not None
    # The camera's y points the other way.
    middle = cloud.points[cloud.cloth].mean(0) * [1, -1, 1]
    np.testing.assert_allclose(middle, [0.2 * 0.4, -0.1 * 0.4, CAMERA.height], atol=0.01)
    assert seen["goal_mask"].sum() < 0.7 * seen["mask"].sum()


def test_goals_of_ones_own_for_an_environment_or_an_episode() -> None:
    drawn = []

    def sampler(rng: np.random.Generator) -> np.ndarray:
        drawn.append(rng.random())
        return folded()

    env = made(goal=sampler)
    env.reset(seed=3)
    env.reset(seed=3)
    assert drawn[0] == drawn[1]
    env.reset(options={"goal": FLAT})
    assert len(drawn) == 2
    np.testing.assert_allclose(env.goal, FLAT, atol=0.01)


def test_pictures() -> None:
    assert made().render() is None
    env = made(render_mode="rgb_array")
    env.reset()
    before = env.render()
    env.step(HALF)
    after = env.render()
    assert before is not None
    assert after is not None
    assert before.shape == after.shape
    middle = before.shape[1] // 2
    np.testing.assert_array_equal(before[:, :middle], after[:, :middle])
    assert (before[:, middle:] != after[:, middle:]).any()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"observation": "images"}, "observation: expected one of vertices, voxels, depth, found 'images'"),
        ({"grasps": "air"}, "grasps: expected cloth or table, found 'air'"),
        ({"goal": "halves"}, "goal: expected one of half, triangle, .*, found 'halves'"),
        ({"goal": ()}, r"goal: expected a mesh, a function that draws one, or names of goals, found \(\)"),
        ({"measure": "iou"}, "measure: expected softgym, error, or a function of mesh and goal, found 'iou'"),
        ({"steps": 0}, "steps: expected at least 1, found 0"),
        ({"render_mode": "human"}, "render_mode: expected rgb_array or None, found 'human'"),
    ],
)
def test_bad_options_are_told_in_one_sentence(options: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        FoldEnv(simulation=COARSE, **options)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"goal": FLAT[:4]}, r"goal: has shape \[4, 8, 3\], expected a mesh \[8, 8, 3\], normalised"),
        ({"start": np.full_like(FLAT, np.inf)}, "start: has vertices that are not finite"),
        ({"start": "thrown"}, "start: expected a mesh, a function that draws one, or one of flat, dragged, crumpled"),
        ({"end": FLAT}, "options: has end, expected goal or start"),
    ],
)
def test_bad_goals_are_told_in_one_sentence(options: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        made().reset(options=options)


def test_softgyms_measure_needs_a_goal_with_a_name() -> None:
    with pytest.raises(InputError, match="measure: softgym is of named goals, but the goal is a mesh"):
        made(measure="softgym").reset()
