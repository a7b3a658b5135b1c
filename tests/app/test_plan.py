"""Plans through the command line: what is written is what a robot can do, in the frame of the file that it saw."""

import dataclasses
import json
from pathlib import Path
from typing import Any
from unittest import mock

import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.app import agent_state
from clothkit.app import plan as plan_command
from clothkit.app import simulate as simulate_command
from clothkit.app.options import observation_options
from clothkit.app.plan_arrays import placed_state
from clothkit.app.plan_file import UNLIKELY, Plan, read_plan, schema
from clothkit.app.planner import begin, decide, for_one_cloth, turned_plan
from clothkit.app.settings import AppConfig
from clothkit.cloth.mesh import distance
from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE
from clothkit.cloth.voxels import Viewport
from clothkit.manipulation.geometry import to_cartesian
from clothkit.observation.camera import CameraConfig
from clothkit.observation.files import read
from clothkit.observation.settings import CloudConfig
from clothkit.planning.planner import Planner
from clothkit.planning.types import Memory, Observation
from tests.app.conftest import AT, ROOT, run, succeed
from tests.app.plans import finding, version_1
from tests.app.schema import violations
from tests.observation.scenes import SCALE, SMALL
from tests.planning import toy

SAID_OF_TABLE = ("--table", *SMALL.table().normal.tolist(), SMALL.table().offset)


def still(net: Any, latent: Any, trace: Any, manipulation: Any) -> Any:
    """The toy world's step, told truly that nothing but the vertices moves, and that the world forgets."""
    mesh, _, shift = toy.step(net, latent, jnp.zeros_like(trace), manipulation)
    return mesh, trace + 1, jnp.zeros_like(shift)


STILL = toy.MODEL._replace(step=still)
FOUND = np.array([[-1, -1, 1, -1, 0.1, 0.7], [0.5, 1, 0.5, 1, -0.6, -0.4]], np.float32)
"""Both hands, then one, instead of what a search finds: with nets that know nothing these may be null manipulations."""


def toy_planner(*_: object, **__: object) -> Planner:
    return for_one_cloth(dataclasses.replace(toy.planner("b1"), model=STILL))


def grasps_on(plan: Plan, step: int) -> np.ndarray:
    """Where the manipulation's grasp points lie before a step, in the plan's frame."""
    placed = plan.start
    if step:
        prediction = plan.steps[step - 1].predictions[plan.memory.best]
        placed = type(placed)(state=prediction.state, centre_m=plan.steps[step - 1].centre_m)
    mesh = placed_state(plan, placed)
    uv = np.array(plan.steps[step].manipulation[:4], np.float32).reshape(2, 2)
    points = np.stack([np.asarray(to_cartesian(mesh, point), float) for point in uv])
    return plan.pose(placed.centre_m).normalised_to_camera(points)


@pytest.mark.parametrize(
    ("state", "options", "frame"),
    [
        ("bent.obj", [], "table"),
        ("bent.obj", ["--system", "main"], "table"),
        ("cloud.npz", [], "camera"),
        ("cloud.npz", ["--frame", "table", "--system", "b2"], "table"),
    ],
)
def test_hands_start_at_the_grasp_points_in_the_plans_frame(
    here: Path, files: Path, state: str, options: list[str], frame: str
) -> None:
    with finding(FOUND, common=3):
        said = succeed("plan", "--state", files / state, "--goal", files / "goal.glb", "--steps", 2, *options)
    plan = read_plan(here / "plan.json")
    assert plan.frame == frame
    assert "plan.json: 2 steps" in said
    # A mesh that is taken as it is explains itself; what was estimated is held against what was seen.
    assert (plan.state.agreement is None) == (plan.system == "b1")
    assert ("the state's estimate" in said) == (plan.system != "b1")
    assert plan.goal.agreement is None
    # How often such plans came true is known of system main alone; what it starts from is estimated here.
    told = plan.expected.trust, plan.expected.outcome_error_m
    assert (None not in told) == (plan.system == "main")
    assert ("trust" in said) == (plan.system == "main")
    assert any("plan's trust" in notice for notice in plan.notices) == (plan.system != "main")
    assert (plan.state.unsure is None) == (plan.start.state.sigma_m is None) == (plan.system == "b1")
    as_it_is = state == "bent.obj" and not options
    assert (plan.state.taken, plan.goal.taken) == ("as it is" if as_it_is else "estimated", "as it is")
    assert (
        f"{files / state}: {'taken as it is' if as_it_is else 'its mesh is estimated from what is seen of it'}" in said
    )
    assert f"{files / 'goal.glb'}: taken as it is" in said
    assert not violations(json.loads((here / "plan.json").read_text()), schema())
    assert [len(step.hands) for step in plan.steps] == [2, 1]
    for number, step in enumerate(plan.steps):
        assert not step.null
        for hand, grasp in zip(step.hands, grasps_on(plan, number)[: len(step.hands)], strict=True):
            np.testing.assert_allclose(hand.grasp_m, grasp, atol=2e-5)
            assert hand.waypoints[0].position_m == hand.grasp_m
            assert hand.waypoints[-1].position_m == hand.release_m
            times = [point.time_s for point in hand.waypoints]
            assert times[0] == 0
            assert times == sorted(times)
    # From the frame of the points to the plan's, where these differ.
    placed = plan.table_in_camera
    assert (placed is not None) == ("--frame" in options)
    if placed is not None:
        down = np.array(placed.axes) @ (np.array([0.0, 0.0, CameraConfig().height]) - placed.origin_m)
        np.testing.assert_allclose(down, np.zeros(3), atol=0.005)
    # Where the cloth lies, seen by whatever.
    centre = plan.pose(plan.start.centre_m).centre
    np.testing.assert_allclose(centre, AT, atol=0.005)
    if frame == "camera":
        # The camera looks down from its height: positions are before it.
        assert plan.start.centre_m[2] == pytest.approx(CameraConfig().height, abs=0.005)


def test_the_same_seed_gives_the_same_file_and_another_directory_no_params(
    here: Path, files: Path, data: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = ("plan", "--state", files / "bent.obj", "--goal", files / "goal.glb", "--steps", 1, "--out")
    for name in ("a.json", "b.json"):
        succeed(*wanted, name)
    assert (here / "a.json").read_bytes() == (here / "b.json").read_bytes()
    succeed(*wanted, "c.json", "--seed", 1)
    assert (here / "a.json").read_bytes() != (here / "c.json").read_bytes()
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    monkeypatch.chdir(elsewhere)
    succeed("estimate", files / "voxels.npy", "--out", "mesh.obj", "--data", data)
    assert (elsewhere / "mesh.obj").exists()


@pytest.mark.parametrize("goal", ["voxels.npy", "surface.obj", "cloth_alone.npz", "bent.obj"])
def test_goals_of_every_kind_and_plans_in_voxels(here: Path, files: Path, goal: str) -> None:
    wanted = ("plan", "--state", files / "cloth_alone.npz", "--goal", files / goal, "--steps", 1, *SAID_OF_TABLE)
    succeed(*wanted)
    plan = read_plan(here / "plan.json")
    assert plan.system == "main"
    # The vertices of the surface are those of a grid in another order.
    assert plan.goal.taken == ("as it is" if goal in ("bent.obj", "surface.obj") else "estimated")
    assert (plan.goal.agreement is None) == (plan.goal.taken == "as it is")
    for source in (plan.state, plan.goal):
        if source.agreement is not None:
            unexplained = f"{source.file}: the estimate does not explain what was seen"
            assert source.agreement.explains != any(notice.startswith(unexplained) for notice in plan.notices)
    succeed(*wanted, "--system", "b4")
    plan = read_plan(here / "plan.json")
    assert plan.state.agreement is None
    assert plan.goal.agreement is None
    assert any("the plan's trust, how often such plans came true, is not known" in told for told in plan.notices)
    assert all("trust" in told or told.startswith("advice: ") for told in plan.notices)
    assert plan.state.unsure is None
    assert plan.expected.error_m is None
    assert plan.expected.voxel_error is not None
    assert plan.start.state.kind == "voxels"
    assert plan.steps[0].hands
    for hand in plan.steps[0].hands:
        on_table = plan.pose(plan.start.centre_m).camera_to_table(np.array(hand.grasp_m))
        # The cloth lies on the table, and is grasped no higher than a few of its layers.
        assert -0.001 <= on_table[2] <= 0.04


def test_a_mask_tells_the_cloth_as_well(here: Path, files: Path) -> None:
    common = ("--goal", files / "goal.glb", "--steps", 1)
    succeed("plan", "--state", files / "points.npy", "--mask", files / "mask.npy", *common, "--out", "a.json")
    succeed("plan", "--state", files / "cloud.npz", *common, "--out", "b.json")
    assert read_plan(here / "a.json").steps == read_plan(here / "b.json").steps


def of_version_1(folder: Path) -> Path:
    """The file plan.json as version 1 would have written it."""
    plan = json.loads((folder / "plan.json").read_text())
    (folder / "old.json").write_text(json.dumps(version_1(plan)))
    return folder / "old.json"


def test_a_plan_read_back_and_simulated_does_what_it_says(here: Path, files: Path) -> None:
    """In the toy world net 0 knows exactly what hands do, so the simulated cloth is where the plan predicts it."""
    goal = np.asarray(toy.dragged(jnp.asarray(SQUARE.flat()), jnp.array([-1, -1, -1, -1, 0.6, 0.5])))
    goal = np.asarray(toy.dragged(jnp.asarray(goal), jnp.array([1, 1, 1, 1, -0.7, -0.3])))
    np.save(here / "goal.npy", goal)
    with mock.patch.object(plan_command, "load_planner", toy_planner):
        said = succeed("plan", "--state", files / "start.obj", "--goal", here / "goal.npy", "--steps", 2)
    plan = read_plan(here / "plan.json")
    assert plan.expected.improves
    assert plan.warning is None
    assert UNLIKELY not in said
    with mock.patch.object(simulate_command, "execute", lambda *of, **_: toy.execute(*of[:4])):
        said = succeed("simulate", "--plan", "plan.json", "--goal", here / "goal.npy", "--out", "mesh.ply")
        again = succeed("simulate", "--state", files / "start.obj", "--plan", "plan.json", "--goal", here / "goal.npy")
        old = succeed("simulate", "--plan", of_version_1(here), "--goal", here / "goal.npy")
    results = [
        [line for line in text.splitlines() if line.startswith(("error", "silhouette"))] for text in (said, again, old)
    ]
    assert results[0] == results[1] == results[2]
    assert len(results[0]) == 2
    assert f"{files / 'start.obj'}: taken as it is" in again.splitlines()
    state = plan.steps[-1].predictions[0].state
    assert state.kind == "mesh"
    found = read(here / "mesh.ply")
    apart = float(distance(found.mesh, placed_state(plan, plan.start)))  # type: ignore[union-attr]
    where = found.pose.normalised_to_table(found.mesh.astype(float))  # type: ignore[union-attr]
    assert apart > 0.1
    # Hands of the toy world take the nearest vertex.
    assert np.linalg.norm(where - np.array(state.vertices_m), axis=-1).mean() < 0.1 * apart * 0.4
    assert "expected" in said


def test_a_plan_that_makes_nothing_better_says_so(here: Path, files: Path) -> None:
    with finding(FOUND):
        said = succeed("plan", "--state", files / "bent.obj", "--goal", files / "bent.obj", "--steps", 1)
    plan = read_plan(here / "plan.json")
    assert not plan.expected.improves
    assert plan.warning == UNLIKELY
    assert said.splitlines()[-1] == UNLIKELY
    assert plan.expected.error_no_action_m == pytest.approx(0, abs=1e-4)
    assert plan.expected.silhouette_iou_no_action > 0.98
    # As files were before estimates were held against what was seen.
    old = json.loads((here / "plan.json").read_text())
    del old["notices"], old["state"]["agreement"], old["goal"]["agreement"]
    (here / "old.json").write_text(json.dumps(old))
    assert plan.notices, "of trust, which is not known"
    back, expected = read_plan(here / "old.json"), plan.model_dump() | {"notices": []}
    assert back.model_dump() == expected


TOWARDS, AWAY = np.float32([[-1, -1, -1, -1, 0.6, 0.5]]), np.float32([[-1, -1, -1, -1, -0.6, -0.5]])


@pytest.mark.parametrize(
    ("plan", "goal", "improves"), [(TOWARDS, "start", True), (AWAY, "outcome", False)], ids=["improves", "useless"]
)
def test_a_plan_is_judged_in_the_labelling_that_was_found(
    here: Path, plan: np.ndarray, goal: str, improves: bool
) -> None:
    """In both cases the goal's own labels would tell the opposite; what was found reverses v."""
    start = toy.bent()
    nets = [np.asarray(toy.dragged(jnp.asarray(start), jnp.asarray(plan[0]), float(net))) for net in toy.NETS]
    outcome = np.mean(nets, axis=0)
    wanted = {"start": start, "outcome": outcome}[goal]
    np.save(here / "start.npy", start)
    np.save(here / "goal.npy", wanted)
    errors = []
    for labelled in (wanted[:, ::-1], wanted):
        for state in (outcome, start):
            off = state.astype(float) - labelled
            errors.append(np.linalg.norm(off - off.mean((0, 1)), axis=-1).mean() / 1.4)
    assert (errors[0] < errors[1]) == improves
    assert (errors[2] < errors[3]) != improves
    with mock.patch.object(plan_command, "load_planner", toy_planner), finding(plan, relative=4):
        said = succeed("plan", "--state", here / "start.npy", "--goal", here / "goal.npy", "--steps", 1)
    found = read_plan(here / "plan.json")
    assert found.expected.error_cloth_lengths == pytest.approx(errors[0], rel=1e-3)
    assert found.expected.error_no_action_cloth_lengths == pytest.approx(errors[1], rel=1e-3)
    assert found.expected.improves == improves
    assert (found.warning == UNLIKELY) == (UNLIKELY in said) == (not improves)


@pytest.mark.parametrize("useless", [False, True])
def test_a_turned_plan_keeps_the_decision_and_turns_its_errors(useless: bool) -> None:
    planner, goal = toy_planner(), np.asarray(toy.dragged(jnp.asarray(SQUARE.flat()), jnp.asarray(0.9 * TOWARDS[0])))
    with finding(TOWARDS):
        planned, _ = decide(planner, Observation(meshes=SQUARE.flat()[None]), begin(planner, goal, 1), seed=0)
    assert not planned.useless
    turned = turned_plan(planner, planned._replace(useless=useless), goal, -np.eye(2))
    np.testing.assert_allclose(turned.plan, [[1, 1, 1, 1, -0.6, -0.5]], atol=1e-5)
    assert turned.expected == pytest.approx(planned.expected, abs=1e-5)
    assert turned.expected_no_action == pytest.approx(planned.expected_no_action, abs=1e-5)
    assert (turned.useless, turned.improves) == (useless, not useless)


def test_after_takes_up_what_is_left(here: Path, files: Path) -> None:
    goal = np.asarray(toy.dragged(jnp.asarray(toy.bent()), jnp.array([-1, -1, -1, -1, 0.6, 0.5])))
    np.save(here / "start.npy", toy.bent())
    np.save(here / "goal.npy", goal)
    memories = []
    original = agent_state.decide

    def spy(planner: Planner, observation: Observation, memory: Memory, **settings: Any) -> Any:
        memories.append(memory)
        return original(planner, observation, memory, **settings)

    with (
        mock.patch.object(plan_command, "load_planner", toy_planner),
        mock.patch.object(agent_state, "decide", spy),
    ):
        common = ("plan", "--goal", here / "goal.npy")
        succeed(*common, "--state", here / "start.npy", "--steps", 2)
        plan = read_plan(here / "plan.json")
        succeed(*common, "--state", here / "start.npy", "--after", "plan.json", "--out", "next.json")
        wrong = run(*common, "--state", here / "start.npy", "--after", "plan.json", "--steps", 2, "--out", "no.json")
        last = run(*common, "--state", here / "start.npy", "--after", "next.json")
    later = read_plan(here / "next.json")
    assert len(later.steps) == 1
    assert later.memory.traces_before is not None
    memory = memories[1]
    np.testing.assert_allclose(memory.rest[0, :1], [plan.steps[1].manipulation], atol=1e-6)
    assert memory.relative[0] == plan.memory.relative == later.memory.relative
    # The state is expected as the nets predict it after the first step, in the mean.
    first = plan.steps[0]
    assert not first.null
    placed = [type(plan.start)(state=each.state, centre_m=first.centre_m) for each in first.predictions]
    means = [placed_state(plan, each) for each in placed]
    np.testing.assert_allclose(memory.expected[0], np.mean(means, axis=0), atol=1e-5)
    stds = [np.array(each.state.sigma_m) / plan.metres_per_normalised for each in first.predictions]
    np.testing.assert_allclose(
        memory.unsure[0] ** 2, np.mean(np.square(stds), axis=0) + np.var(means, axis=0), rtol=1e-2
    )
    # A toy trace counts the manipulations that were executed.
    assert all((np.array(trace) == (not plan.steps[0].null)).all() for trace in later.memory.traces_before)
    assert wrong.exit_code == 1
    assert wrong.stderr.strip().endswith("--steps: expected 1, what is left of plan.json, found 2")
    assert "nothing is left" in last.stderr


@pytest.mark.parametrize("name", ["main", "b4"])
def test_every_kind_of_system_goes_on_and_predicts(here: Path, files: Path, name: str) -> None:
    """From the file alone: what it remembers is enough for what comes after it."""
    common = ("--goal", files / "goal.glb", "--state", files / "voxels.npy")
    succeed("plan", *common, "--system", name, "--steps", 2)
    succeed("plan", *common, "--after", "plan.json", "--out", "next.json")
    plan, later = read_plan(here / "plan.json"), read_plan(here / "next.json")
    assert later.system == name
    assert plan.memory.traces_before is None
    assert (later.memory.traces_before is None) == plan.steps[0].null
    assert later.memory.relative == plan.memory.relative
    assert not violations(json.loads((here / "next.json").read_text()), schema())
    succeed("predict", "--state", files / "voxels.npy", "--plan", "next.json")
    nets = {str(prediction.net) for prediction in later.steps[0].predictions}
    assert {path.stem[-1] for path in (here / "predicted").iterdir()} == nets
    old = of_version_1(here)
    succeed("plan", *common, "--after", old, "--out", "next_of_old.json")
    assert read_plan(here / "next_of_old.json") == later
    for plan_file in ("plan.json", old):
        succeed("predict", "--state", files / "voxels.npy", "--plan", plan_file, "--out", f"by_{Path(plan_file).stem}")
    for path in (here / "by_plan").iterdir():
        assert (here / "by_old" / path.name).read_bytes() == path.read_bytes()
    other = run("plan", *common, "--after", "plan.json", "--system", "b3", "--out", "no.json")
    assert other.exit_code == 1
    assert "--system: expected" in other.stderr


def test_a_plan_is_turned_into_reach_and_its_goal_with_it(here: Path, files: Path) -> None:
    """The flat cloth looks the same turned by right angles; what is beyond its middle is out of reach."""
    goal = np.asarray(toy.dragged(jnp.asarray(SQUARE.flat()), jnp.array([-1, -1, -1, -1, 0.6, 0.5])))
    np.save(here / "goal.npy", goal)
    with mock.patch.object(plan_command, "load_planner", toy_planner):
        wanted = ("plan", "--state", files / "start.obj", "--goal", here / "goal.npy", "--steps", 1)
        succeed(*wanted, "--out", "free.json")
        free = read_plan(here / "free.json")
        xy = np.concatenate([[point.position_m for point in hand.waypoints] for hand in free.steps[0].hands])[:, :2]
        assert free.turned is None
        # The opposite quadrant, or wherever the half turn brings the hands.
        low, high = 2 * np.array(AT) - xy.max(0) - 0.01, 2 * np.array(AT) - xy.min(0) + 0.01
        said = succeed(*wanted, "--reach", *low, -1, *high, 1)
        plan = read_plan(here / "plan.json")
        nowhere = run(*wanted, "--reach", 5, 5, -1, 6, 6, 1, "--out", "none.json")
    np.testing.assert_allclose(np.array(plan.turned), -np.eye(2), atol=1e-6)
    assert "turned" in said
    moved = np.concatenate([[point.position_m for point in hand.waypoints] for hand in plan.steps[0].hands])[:, :2]
    np.testing.assert_allclose(moved, 2 * np.array(AT) - xy, atol=1e-4)
    # It reaches the turned goal as well as the first reached the goal.
    assert plan.expected.error_m == pytest.approx(free.expected.error_m, abs=1e-4)
    first, turned = (p.steps[0].predictions[0].state for p in (free, plan))
    assert first.kind == turned.kind == "mesh"
    one, other = (np.array(state.vertices_m) - [*AT, 0] for state in (first, turned))
    low_sorted, other_sorted = (np.sort(array.reshape(-1, 3), axis=0) for array in (one * [-1, -1, 1], other))
    np.testing.assert_allclose(low_sorted, other_sorted, atol=1e-4)
    assert nowhere.exit_code == 1
    assert "outside the box" in nowhere.stderr
    assert not (here / "none.json").exists()


def test_side_and_table_come_from_params_unless_options_say_otherwise() -> None:
    app = AppConfig(side=0.5, table=(0.0, 0.0, 2.0, 1.0))
    how = observation_options(app, side=None, table=None, table_colour=(1, 2, 3, 4, 5, 6), box=None)
    assert how.side == 0.5
    assert how.table is not None
    assert how.table.offset == 0.5
    assert how.cloud.table_colour == ((1, 2, 3), (4, 5, 6))
    assert observation_options(app, side=0.3, table=None, table_colour=None, box=None).side == 0.3


def test_a_camera_sees_half_a_layer_above_the_vertices_and_as_high_as_the_nets() -> None:
    tall = CloudConfig(viewport=Viewport(height=0.4))
    how = observation_options(AppConfig(cloud=tall), side=None, sides=(0.5, 0.3), thickness=0.006)
    assert how.cloud.surface == 0.003
    assert how.cloud.highest == pytest.approx(0.4 * 0.5 / CLOTH_LENGTH)
    set_by_hand = observation_options(AppConfig(cloud=CloudConfig(surface=0.001, highest=0.3)), side=0.4)
    assert (set_by_hand.cloud.surface, set_by_hand.cloud.highest) == (0.001, 0.3)


def test_the_published_schema_is_the_one_that_plans_are_read_by() -> None:
    assert json.loads((ROOT / "docs/plan.schema.json").read_text()) == schema()


def test_estimates_predictions_and_simulations_are_files(here: Path, files: Path) -> None:
    succeed("estimate", files / "cloud.npz", "--out", "mesh.ply")
    with np.load(here / "mesh.sigma.npz") as found:
        assert {name: found[name].shape for name in found} == dict.fromkeys(("mesh", "mean", "sigma"), (32, 32, 3))
        assert (found["sigma"] > 0.01 * SCALE * 0.99).all()
    succeed("plan", "--state", files / "bent.obj", "--goal", files / "goal.glb", "--steps", 2)
    succeed("predict", "--state", files / "bent.obj", "--plan", "plan.json", "--out", "predicted")
    plan = read_plan(here / "plan.json")
    names = {f"step_{n}_net_{net}.{ending}" for n in (1, 2) for net in (0, 1) for ending in ("obj", "npz")}
    assert {path.name for path in (here / "predicted").iterdir()} == names
    for number, step in enumerate(plan.steps, start=1):
        for prediction in step.predictions:
            assert prediction.state.kind == "mesh"
            with np.load(here / f"predicted/step_{number}_net_{prediction.net}.npz") as found:
                np.testing.assert_allclose(found["mean"], prediction.state.vertices_m, atol=1e-4)
                np.testing.assert_allclose(found["sigma"], prediction.state.sigma_m, atol=1e-4)
