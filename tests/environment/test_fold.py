"""The environment: its library's own checker; rewards, observations and manipulations against other computations."""

from typing import Any

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env

import clothkit.environment
from clothkit.cloth import voxels
from clothkit.cloth.mesh import error
from clothkit.cloth.silhouette import centred
from clothkit.environment.fold import FoldEnv
from clothkit.environment.goals import RandomFolds
from clothkit.observation.camera import CameraConfig, DepthImage, back_project
from clothkit.runtime.errors import InputError
from clothkit.simulation.executor import execute
from clothkit.simulation.settings import SimulationConfig
from clothkit.simulation.world import Worlds

COARSE = SimulationConfig(side=8)
"""A cloth that is simulated in no time."""
CAMERA = CameraConfig(columns=40, rows=30, focal=37.0)
FLAT = COARSE.topology.flat()
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


@pytest.mark.parametrize("kind", ["vertices", "voxels", "depth"])
def test_the_librarys_checker_finds_nothing(kind: str) -> None:
    """Warnings are errors here, and so are those of the checker."""
    check_env(made(observation=kind, steps=2))


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
    env = made(measure=lambda mesh, goal: float(np.ptp(mesh[..., 0])), tolerance=0.9)
    env.reset()
    _, reward, terminated, _, info = env.step(HALF)
    width = float(np.ptp(folded()[..., 0]))
    assert reward == pytest.approx(1.4 - width, abs=1e-5)
    assert terminated == (width <= 0.9)
    assert info["error_start"] == pytest.approx(1.4)


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


def test_the_same_seed_draws_the_same_folds() -> None:
    worlds = Worlds(1, SimulationConfig(side=16))
    draw = RandomFolds(1, 2, worlds)
    one, same, other = (draw(np.random.default_rng(seed)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(one, same)
    flat = worlds.topology.flat()
    for mesh, least in ((one, 0.02), (other, 0.02)):
        assert float(error(mesh, flat, aligned=True, topology=worlds.topology)) > least
    assert float(error(one, other, aligned=True, topology=worlds.topology)) > 0.02
    by_seed = [made(goal=None, simulation=SimulationConfig(side=16), steps=1).reset(seed=s)[0] for s in (5, 5)]
    np.testing.assert_array_equal(by_seed[0]["goal"], by_seed[1]["goal"])


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
        ({"end": FLAT}, "options: has end, expected goal or start"),
    ],
)
def test_bad_goals_are_told_in_one_sentence(options: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        made().reset(options=options)
