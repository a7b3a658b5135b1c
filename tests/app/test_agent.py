"""The agent of a person's own program: what it observes and plans is in metres, and it remembers what commands read."""

import dataclasses
import subprocess
import sys
from pathlib import Path
from unittest import mock

import jax.numpy as jnp
import numpy as np
import pytest

import clothkit
from clothkit.app import plan as plan_command
from clothkit.app.agent import Agent
from clothkit.app.inputs import load_settings
from clothkit.app.options import observation_options
from clothkit.app.plan_file import read_plan
from clothkit.app.planner import for_one_cloth
from clothkit.cloth.mesh import error
from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import SQUARE
from clothkit.manipulation.geometry import to_cartesian
from clothkit.planning.planner import Planner
from clothkit.runtime.errors import InputError
from tests.app.conftest import AT, succeed
from tests.app.plans import finding
from tests.app.test_plan import FOUND, STILL
from tests.observation.scenes import SCALE, SMALL, folded
from tests.planning import toy

PLACE = np.array([*AT, 0.0])
TABLE = (*SMALL.table().normal.tolist(), SMALL.table().offset)


def metres(mesh: np.ndarray) -> np.ndarray:
    return mesh.astype(float) * SCALE + PLACE


def toy_agent(system: str = "b1", planner: Planner | None = None) -> Agent:
    """An agent in the toy world, with the settings of the current directory."""
    settings = load_settings(Path("data"))
    options = observation_options(settings.app, side=None, table=None)
    planner = planner or for_one_cloth(dataclasses.replace(toy.planner(system), model=STILL))
    return Agent.of(planner, settings, options)


def test_importing_clothkit_imports_nothing_else() -> None:
    told = "import sys, clothkit; print(sorted({'jax', 'numpy', 'click', 'pydantic'} & set(sys.modules)))"
    ended = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    assert ended.stdout.strip() == "[]"
    assert clothkit.Agent is Agent
    # Types are for who calls it, too.
    assert (Path(clothkit.__file__).parent / "py.typed").exists()
    assert set(clothkit.__all__) <= set(dir(clothkit))
    with pytest.raises(AttributeError, match="no attribute 'agents'"):
        clothkit.agents  # noqa: B018


@pytest.mark.parametrize("name", ["main", "b4"])
def test_what_is_observed_is_in_metres_in_the_observers_frame(here: Path, files: Path, name: str) -> None:
    cloud = np.load(files / "cloud.npz")
    agent = Agent("data", system=name)
    agent.begin(files / "goal.glb", steps=1)
    seen = agent.observe(cloud["points"], mask=cloud["cloth"])
    assert seen.frame == "camera"
    # The camera looks down from its height; the table's x is its own, and y points the other way.
    np.testing.assert_allclose(seen.centre_m[:2], [AT[0], -AT[1]], atol=0.005)
    assert seen.centre_m[2] == pytest.approx(SMALL.height, abs=0.005)
    grasps = seen.grasps_m
    assert len(grasps) >= 1
    away = np.linalg.norm(cloud["points"][cloud["cloth"]][:, None, :2] - grasps[:, :2], axis=-1).min(0)
    if name == "b4":
        assert seen.vertices_m is None
        assert away.max() < 0.03
    else:
        assert seen.vertices_m is not None
        nearest = np.linalg.norm(seen.vertices_m.reshape(-1, 1, 3) - grasps, axis=-1).min(0)
        np.testing.assert_allclose(nearest, 0, atol=1e-5)
    assert (seen.agreement is None) == (name == "b4")
    in_table = Agent("data", system=name, frame="table")
    in_table.begin(files / "goal.glb", steps=1)
    again = in_table.observe(files / "cloud.npz")
    np.testing.assert_allclose(again.centre_m, PLACE, atol=0.005)
    np.testing.assert_allclose(again.grasps_m[:, :2] * [1, -1], grasps[:, :2], atol=1e-3)
    assert again.error == pytest.approx(seen.error, abs=1e-4)


def test_a_mesh_that_is_taken_as_it_is(here: Path) -> None:
    mesh = folded(angle=0.3)
    agent = toy_agent()
    agent.begin(metres(SQUARE.flat()), steps=1)
    seen = agent.observe(metres(mesh))
    np.testing.assert_allclose(seen.vertices_m, metres(mesh), atol=1e-5)
    np.testing.assert_allclose(seen.centre_m, PLACE + np.append(centred(mesh)[1] * SCALE, 0), atol=1e-5)
    assert seen.error == pytest.approx(float(error(mesh, SQUARE.flat(), aligned=True)), abs=1e-5)
    assert seen.agreement is None
    with finding(FOUND):
        plan = agent.plan()
    # The mesh is known, and trust in the plan needs to know that: NaN would mean that nothing is told.
    assert agent.state.planned is not None
    assert agent.state.planned.sigma == 0
    uv = FOUND[0, :4].reshape(2, 2)
    grasps = [np.asarray(to_cartesian(mesh, point), float) for point in uv]
    for hand, point in zip(plan.steps[0].hands, grasps, strict=True):
        np.testing.assert_allclose(hand.grasp_m, metres(point), atol=1e-5)
        assert hand.waypoints[-1].position_m == hand.release_m


def test_an_agent_remembers_what_commands_take_from_a_plan_file(here: Path) -> None:
    start = centred(toy.bent())[0]
    goal = np.asarray(toy.dragged(jnp.asarray(start), jnp.asarray(FOUND[0])))
    np.save(here / "start.npy", start)
    np.save(here / "goal.npy", goal)
    agent = toy_agent().begin("goal.npy", steps=2)
    assert agent.left == 2
    agent.observe("start.npy")
    with finding(FOUND, common=3, relative=2):
        first = agent.plan(seed=3)
        assert agent.left == 1
        np.save(here / "after.npy", toy.dragged(jnp.asarray(start), jnp.asarray(FOUND[0])))
        # Seen in other labels than before: the agent goes on in those that it expects.
        np.save(here / "turned.npy", np.load(here / "after.npy")[::-1].swapaxes(0, 1))
        seen = agent.observe("turned.npy", executed=True)
        second = agent.plan(seed=4)
    assert agent.left == 0
    mesh = np.load(here / "after.npy")
    np.testing.assert_allclose(seen.vertices_m, mesh.astype(float) * SCALE, atol=1e-4)
    planner = agent.state.planner
    with mock.patch.object(plan_command, "load_planner", return_value=planner):
        common = ("plan", "--goal", "goal.npy")
        with finding(FOUND, common=3, relative=2):
            succeed(*common, "--state", "start.npy", "--steps", 2, "--seed", 3, "--out", "one.json")
            succeed(*common, "--state", "turned.npy", "--after", "one.json", "--seed", 4, "--out", "two.json")
    assert first == read_plan(here / "one.json")
    other = read_plan(here / "two.json")
    assert second.memory == other.memory
    assert second.steps[0].hands == other.steps[0].hands
    assert second.expected == other.expected
    wide = observation_options(load_settings(Path("data")).app, side=0.8, table=None)
    with pytest.raises(InputError, match=r"sides: expected 0\.4 x 0\.4, for which one\.json was planned, found 0\.8"):
        Agent.of(planner, load_settings(Path("data")), wide).begin("goal.npy", after="one.json")
    with pytest.raises(InputError, match=r"one\.json: was planned by system b1, expected b4, the agent's"):
        Agent("data", system="b4").begin("goal.npy", after="one.json")
    again = toy_agent(planner=planner).begin("goal.npy", after=here / "one.json")
    assert again.left == 1
    np.testing.assert_allclose(again.state.memory.expected[0], agent.state.memory.expected[0], atol=1e-4)
    np.testing.assert_allclose(again.state.memory.unsure[0], agent.state.memory.unsure[0], rtol=1e-2)


def test_what_was_not_executed_is_left_and_what_helps_nothing_is_used_up(here: Path) -> None:
    start = centred(toy.bent())[0]
    agent = toy_agent().begin(metres(start), steps=2)
    agent.observe(metres(start))
    with finding(FOUND):
        plan = agent.plan()
    assert not plan.expected.improves
    for executed, left, count in ((False, 2, 0), (None, 1, 0), (True, 1, 1)):
        other = agent.copy()
        other.observe(metres(start), executed=executed)
        assert other.left == left
        memory = other.state.memory
        # A toy trace counts the manipulations that were executed.
        assert all((trace == count).all() for trace in memory.traces)
        if left == 1:
            fold = jnp.asarray(FOUND[0])
            each = [np.asarray(toy.dragged(jnp.asarray(start), fold, net)) for net in toy.NETS]
            expected = np.mean(each, axis=0) if executed else start
            assert bool(np.isinf(memory.unsure).all()) == (not executed)
            np.testing.assert_allclose(memory.expected[0], expected, atol=1e-5)
            np.testing.assert_allclose(memory.rest[0, 0], FOUND[1])
        if executed:
            # What is left undone after it leaves what is expected.
            with finding(FOUND[1:]):
                other.plan()
            other.observe(metres(start), executed=None)
            np.testing.assert_array_equal(other.state.memory.expected, memory.expected)
            np.testing.assert_array_equal(other.state.memory.unsure, memory.unsure)
    assert agent.left == 1
    # Another plan takes the place of the one that waits.
    with finding(FOUND):
        agent.plan(seed=1)
    assert agent.left == 1


def test_a_camera_that_moves_tells_its_table_each_time(here: Path, files: Path) -> None:
    alone = np.load(files / "cloth_alone.npz")["points"]
    agent = Agent("data", table=(0, 0, 1, 5)).begin(files / "goal.glb", steps=1)
    with pytest.raises(InputError, match="cloth"):
        agent.observe(alone)
    first = agent.observe(alone, table=TABLE)
    farther = np.array([0, 0, 0.1])
    lower = agent.observe(alone + farther, table=(*TABLE[:3], TABLE[3] - 0.1))
    np.testing.assert_allclose(lower.centre_m, first.centre_m + farther, atol=1e-3)


def test_what_is_wrong_is_one_sentence_and_changes_nothing(here: Path, files: Path) -> None:
    agent, flat = toy_agent(), metres(SQUARE.flat())
    with pytest.raises(InputError, match="no session has begun"):
        agent.observe(flat)
    with pytest.raises(InputError, match="steps: expected 1, 2 or 3 manipulations or auto, found 4"):
        agent.begin(flat, steps=4)
    with pytest.raises(InputError, match="steps: expected 1, 2 or 3 manipulations or auto, found None"):
        agent.begin(flat)
    agent.begin(flat, steps=1)
    with pytest.raises(InputError, match="has observed nothing"):
        agent.plan()
    with pytest.raises(InputError, match=r"cloth: the mesh's side is 1\.4 along its edges, expected"):
        agent.observe(SQUARE.flat())
    with pytest.raises(InputError, match="vertices that are not finite"):
        agent.observe(np.where(flat > 0.2, np.nan, flat))
    with pytest.raises(InputError, match="mask: is for points, but cloth holds none"):
        agent.observe(flat, mask=np.ones(1024))
    with pytest.raises(InputError, match="mask: expected 1600 of 0 and 1"):
        agent.observe(np.zeros((1600, 3)), mask=np.ones(5))
    with pytest.raises(InputError, match=r"cloth: has shape \[3\], expected"):
        agent.observe(np.zeros(3))
    for options, says in (
        ({"thickness": 5.0}, "--thickness: 5, expected metres above 0, at most 0.1"),
        ({"side": 400.0}, "--side: 400, expected metres, from 0.01 to 10"),
        ({"table_colour": (0, 60, 0)}, "--table-colour: expected six numbers"),
    ):
        with pytest.raises(InputError, match=says):
            Agent("data", **options)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"none\.obj: not found"):
        agent.observe("none.obj")
    assert agent.left == 1
    assert agent.state.perceived is None
    agent.observe(flat)
    with finding(FOUND):
        last = agent.plan()
    agent.observe(flat)
    with pytest.raises(InputError, match="session is over"):
        agent.plan()
    with pytest.raises(InputError, match="the plan before: has one step, so nothing is left"):
        agent.begin(flat, after=last)
    with pytest.raises(InputError, match="system: expected one of main"):
        Agent("data", system="b9")
