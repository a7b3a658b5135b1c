"""Plans that are impossible, or contradict themselves or what they are used with, are refused before anything runs."""

import json
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest

from clothkit.app import predict as predict_command
from clothkit.app import simulate as simulate_command
from clothkit.app.plan_file import plan_of, read_plan
from clothkit.app.plan_parts import LONGEST
from clothkit.planning.systems import SYSTEMS
from clothkit.runtime.errors import InputError
from clothkit.simulation.world import Worlds
from tests.app.conftest import run, succeed
from tests.app.plans import changed, content, version_1, write

PLANS = {name: content(name) for name in ("b1", "b2", "b4", "main")}
HAND = PLANS["b1"]["steps"][0]["hands"][0]
MESH = PLANS["b1"]["start"]["state"]
VOXELS = PLANS["b4"]["start"]["state"]
UNSURE = {
    "threshold_m": 0.02,
    "share": 0.25,
    "part": "quarter",
    "centre_m": [0.05, -0.03, 0.0],
    "hidden": 0.5,
    "unseen": 0.0,
}
ELSEWHERE = {**MESH, "vertices_m": np.add(MESH["vertices_m"], [1, 0, 0]).tolist()}


def waypoints(change: dict[int, float]) -> list[dict[str, Any]]:
    """Those of a hand, some of them at other times."""
    return [{**point, "time_s": change.get(i, point["time_s"])} for i, point in enumerate(HAND["waypoints"])]


def moved(part: str, by: float) -> dict[str, Any]:
    """A hand whose first or last waypoint, and what is told of it, is elsewhere."""
    at = [HAND[part][0], HAND[part][1] + by, HAND[part][2]]
    points = [dict(point) for point in HAND["waypoints"]]
    points[0 if part == "grasp_m" else -1]["position_m"] = at
    return {**HAND, part: at, "waypoints": points}


ABSURD: list[tuple[str, str, object, str]] = [
    # system, field, value, what the sentence says
    ("b1", "system", "b9", "system: expected one of main, b1"),
    ("b1", "system", "b2", "steps.0.predictions: expected one, since system b2 has one net, found 2"),
    ("b1", "system", "b4", "start.state.kind: expected voxels"),
    ("b1", "side_m", 1e-6, "side_m: input should be greater than or equal to 0.01, found 1e-06"),
    ("b1", "side_m", 1e6, "side_m: input should be less than or equal to 10"),
    ("b1", "side_m", 0.5, "metres_per_normalised: expected side_m / 1.4, 0.357143, found 0.285714"),
    ("b1", "sides_m", (0.5, 0.3), "sides_m: expected side_m, 0.4, and a shorter side, found 0.5 0.3"),
    ("b1", "sides_m", (0.4, 0.5), "sides_m: expected side_m, 0.4, and a shorter side, found 0.4 0.5"),
    ("b1", "metres_per_normalised", 0.3, "metres_per_normalised: expected side_m / 1.4"),
    ("b1", "metres_per_normalised", 1e-300, "metres_per_normalised: expected side_m / 1.4"),
    ("b1", "table.axes", [[0, 0, 0]] * 3, "table.axes: expected unit vectors at right angles"),
    ("b1", "table.axes", [[1, 0.2, 0], [0, 1, 0], [0, 0, 1]], "table.axes: expected unit vectors at right angles"),
    ("b1", "table.axes", [[2, 0, 0], [0, 2, 0], [0, 0, 2]], "table.axes: expected unit vectors"),
    ("b1", "table.axes", [[1e300, 0, 0], [0, 1, 0], [0, 0, 1]], "table.axes"),
    ("b1", "table.axes", [[1, 0, 0], [0, -1, 0], [0, 0, 1]], "z being x cross y"),
    ("b1", "table.axes", [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], "table: expected the axes x, y, z"),
    ("b1", "table.origin_m", [1e6, 0, 0], "table.origin_m.0: input should be less than or equal to 100, found 1000000"),
    ("b1", "table.origin_m", [0, 0, 1], "table: expected the axes x, y, z and the origin 0 0 0, since frame is table"),
    ("b1", "turned", [[1, 0], [0.5, 1]], "turned: expected a matrix that turns or mirrors"),
    ("b4", "turned", [[0, 1], [-1, 0]], "turned: expected null"),
    ("b1", "state.kind", "points", "state.kind: expected mesh"),
    (
        "b1",
        "start.centre_m",
        [0.05, -0.03, 0.2],
        "start.centre_m: expected a point on the table, found one 0.2 m",
    ),
    ("b1", "start.centre_m", [0.45, -0.03, 0], "start.centre_m: expected the middle of start.state"),
    ("b1", "start.state", ELSEWHERE, "start.centre_m: expected the middle of start.state"),
    ("b1", "start.state", VOXELS, "start.state.kind: expected mesh"),
    ("b1", "start.state.vertices_m.3.4.0", 90, "start.state.vertices_m: expected within 20 cloth sides"),
    ("b4", "start.state.occupancy.0.0.0", 1.5, "start.state.voxels.occupancy.0.0.0"),
    ("b1", "steps", PLANS["b1"]["steps"] * 2, "steps: list should have at most 3 items"),
    ("b1", "steps.0.manipulation.0", 1.01, "steps.0.manipulation.0: input should be less than or equal to 1"),
    ("b1", "steps.0.manipulation.4", 1000, f"less than or equal to {LONGEST:g}, found 1000"),
    ("b1", "steps.0.manipulation.5", -1000, "greater than or equal to"),
    ("b1", "steps.0.manipulation.4", 1.3, "steps.0.hands.0.release_m: expected the release point of eq. (1)"),
    ("b1", "steps.0.manipulation.1", 0.5, "steps.0.hands.0.grasp_m: expected the manipulation's grasp point"),
    ("b4", "steps.0.manipulation.1", 0.5, "steps.0.hands.0.grasp_m: expected the manipulation's grasp point"),
    ("b1", "steps.1.manipulation.3", 0.5, "steps.1.hands: expected 2, by its manipulation, found 1"),
    ("b1", "steps.0.manipulation", [1, -1, 1, -1, -1.3, 0], "steps.0.hands: expected 1, by its manipulation, found 2"),
    ("b1", "steps.0.manipulation", [1, -1, 1, 1, 0.1, 0], "steps.0.null: expected true, by a displacement of 0.07"),
    ("b1", "steps.0.null", True, "steps.0.null: expected false"),
    ("b1", "steps.0.hands", [], "steps.0.hands: expected 2"),
    ("b1", "steps.0.hands", [HAND] * 3, "steps.0.hands"),
    ("b1", "steps.0.hands.0", moved("grasp_m", 0.02), "steps.0.hands.0.grasp_m: expected the manipulation's grasp"),
    ("b1", "steps.0.hands.0", moved("release_m", 0.02), "steps.0.hands.0.release_m: expected the release point of eq."),
    ("b1", "steps.0.hands.0.release_m", [0, 0, 0], "steps.0.hands.0.release_m: expected the last waypoint"),
    ("b1", "steps.0.hands.0.grasp_m", [0, 0, 0], "steps.0.hands.0.grasp_m: expected the first waypoint"),
    ("b1", "steps.0.hands.0.waypoints", waypoints({0: 0.01}), "steps.0.hands.0.waypoints.0.time_s: expected 0"),
    ("b1", "steps.0.hands.0.waypoints", waypoints({9: 0.0}), "steps.0.hands.0.waypoints.9.time_s: expected later"),
    (
        "b1",
        "steps.0.hands.0.waypoints",
        waypoints({20: 1e9}),
        "waypoints.20.time_s: input should be less than",
    ),
    ("b1", "steps.0.hands.0.waypoints", waypoints({20: 9.0}), "steps.0.hands: expected waypoints at the same times"),
    ("b1", "steps.0.hands.0.hand", 1, "steps.0.hands: expected different ones of the robot's hands, or null for both"),
    ("b1", "steps.0.hands.0.hand", 2, "steps.0.hands.0.hand: input should be less than or equal to 1"),
    ("b1", "steps.0.hands.0.waypoints.4.position_m", [0, 0, 99], "steps.0.hands.0.waypoints: expected within 20 cloth"),
    (
        "b1",
        "steps.1.predictions",
        PLANS["b1"]["steps"][1]["predictions"][:1],
        "steps.1.predictions: expected nets 0, 1, as in steps.0, found 0",
    ),
    ("b1", "steps.0.predictions", [], "steps.0.predictions: list should have at least 1 item"),
    ("b1", "steps.0.predictions.1.net", 0, "steps.0.predictions: expected different nets, found 0, 0"),
    ("b1", "steps.0.predictions.1.net", "b", "steps.0.predictions.1.net: input should be a valid integer, found 'b'"),
    ("b1", "steps.0.predictions.1.net", -1, "steps.0.predictions.1.net: input should be greater than or equal to 0"),
    ("b1", "steps.1.predictions.1.net", 7, "steps.1.predictions: expected nets 0, 1, as in steps.0, found 0, 7"),
    ("b2", "steps.1.predictions.0.net", 1, "steps.1.predictions: expected nets 0, as in steps.0, found 1"),
    ("b1", "steps.1.predictions.0.state", VOXELS, "steps.1.predictions.0.state.kind: expected mesh"),
    ("b1", "steps.1.centre_m", [99, 0, 0], "steps.1.centre_m: expected within 20 cloth sides"),
    ("b1", "steps.1.centre_m", [0, 0, 1], "steps.1.centre_m: expected a point on the table"),
    ("b2", "steps.0.disagreement_m", 0.1, "steps.0.disagreement_m: expected null for 1 net of system b2"),
    ("b1", "steps.0.disagreement_m", None, "steps.0.disagreement_m: expected a number for 2 nets of system b1"),
    ("b4", "steps.0.disagreement_m", 0.1, "steps.0.disagreement_m: expected null for 2 nets of system b4"),
    ("b1", "expected.error_m", 0.4, "expected.error_m: expected error_cloth_lengths times side_m, 0.04, found 0.4"),
    ("b1", "expected.error_m", None, "expected.error_m: expected a number"),
    ("b4", "expected.error_m", 0.1, "expected.error_m: expected null"),
    ("b2", "expected.epistemic_uncertainty", 1, "expected.epistemic_uncertainty: expected null"),
    ("b4", "expected.prediction_error_m", 0.1, "expected.prediction_error_m: expected null for system b4"),
    ("b1", "table_in_camera", PLANS["b1"]["table"], "table_in_camera: expected null, unless frame is table and the"),
    ("main", "state.unsure", UNSURE, "state.unsure: expected null, since start.state has no standard deviations"),
    ("b4", "state.unsure", UNSURE, "state.unsure: expected null, since start.state has no standard deviations"),
    ("main", "goal.unsure", UNSURE, "goal.unsure: expected null, since start.state alone has standard deviations"),
    ("main", "state.unsure", {**UNSURE, "part": None}, "state.unsure.part: expected one, by share"),
    ("main", "state.unsure", {**UNSURE, "share": 0.0}, "state.unsure.part: expected null, by share"),
    ("main", "state.unsure", {**UNSURE, "unseen": 0.6}, "state.unsure.unseen: expected at most what hidden leaves"),
    ("b1", "expected.improves", False, "expected.improves: expected true"),
    ("b4", "memory.common", 3, "memory.common: expected at most 0"),
    ("b2", "memory.best", 1, "memory.best: expected at most 0 for 1 net of system b2, found 1"),
    ("b1", "memory.best", 2, "memory.best: expected at most 1 for 2 nets of system b1, found 2"),
    ("b1", "version", 3, "version: input should be 2"),
    ("b1", "version", True, "version: input should be 2"),
    ("b1", "memory.traces_before", [[[0.0]] * 8], "memory.traces_before: expected 2 of 8 rows, found 1 of 8"),
    (
        "b2",
        "memory.traces_before",
        [[[1e300]] * 8],
        "memory.traces_before.0.0.0: input should be less than",
    ),
    ("b1", "turned", [[1e300, 0], [0, 1e300]], "turned: expected a matrix that turns or mirrors"),
    ("b2", "memory.traces_before", [[[0.0]] * 7 + [[0.0, 1.0]]], "memory.traces_before: expected rows of one length"),
]
IDS = [f"{i}-{field}" for i, (_, field, _, _) in enumerate(ABSURD)]


@pytest.mark.parametrize("name", SYSTEMS)
def test_plans_of_every_system_are_read(tmp_path: Path, name: str) -> None:
    for side in (0.05, 0.4, 2.0):
        write(tmp_path / "plan.json", content(name, side=side))
        assert read_plan(tmp_path / "plan.json").side_m == side


@pytest.mark.parametrize("members", [(4,), (2, 0, 7), (0, 1, 2, 3, 9)], ids=len)
def test_plans_of_any_number_of_nets_are_read(tmp_path: Path, members: tuple[int, ...]) -> None:
    for name in ("main", "b4"):
        plan = changed(content(name, members=members), "memory.best", len(members) - 1)
        write(tmp_path / "plan.json", plan)
        found = read_plan(tmp_path / "plan.json")
        assert tuple(prediction.net for prediction in found.steps[1].predictions) == members
        assert found == plan_of(plan)


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_file_of_version_1_means_what_it_meant(tmp_path: Path, name: str) -> None:
    one_net = SYSTEMS[name].single
    plan = content(name, members=(1,) if one_net else (0, 1))
    plan = plan if one_net else changed(plan, "memory.best", 1)
    old = version_1(plan)
    assert [prediction["net"] for prediction in old["steps"][1]["predictions"]] == (["b"] if one_net else ["a", "b"])
    assert old["memory"]["better"] == (not one_net)
    write(tmp_path / "old.json", old)
    write(tmp_path / "new.json", plan)
    assert read_plan(tmp_path / "old.json") == read_plan(tmp_path / "new.json")


VERSION_1: list[tuple[str, object, str]] = [
    ("steps.0.predictions.1.net", "c", "steps.0.predictions.1.net: input should be a valid integer, found 'c'"),
    ("steps.0.predictions.1.net", "a", "steps.0.predictions: expected different nets, found 0, 0"),
    ("steps.0.predictions", 3, "steps.0.predictions: input should be a valid array"),
    ("steps.1", None, "steps.1: input should be an object"),
    ("steps", "", "steps: input should be a valid array"),
    ("memory.better", ..., "memory.best: field required"),
    ("memory.better", 2, "memory.best: expected at most 1"),
    ("memory.best", 1, "memory.better: extra inputs are not permitted"),
    ("memory", [], "memory: input should be an object"),
    ("seed", float("nan"), "seed: input should be a valid integer"),
]


@pytest.mark.parametrize(
    ("field", "value", "says"), VERSION_1, ids=[f"{field}-{value}" for field, value, _ in VERSION_1]
)
def test_a_fault_in_a_file_of_version_1_is_one_sentence(tmp_path: Path, field: str, value: object, says: str) -> None:
    write(tmp_path / "plan.json", changed(version_1(PLANS["b1"]), field, value))
    with pytest.raises(InputError) as told:
        read_plan(tmp_path / "plan.json")
    assert str(told.value).startswith(f"{tmp_path}/plan.json: ")
    assert says in str(told.value)
    assert "\n" not in str(told.value)


def test_keys_that_stand_twice_are_told_in_files_of_version_1_too(tmp_path: Path) -> None:
    text = json.dumps(version_1(PLANS["b1"]))
    (tmp_path / "plan.json").write_text(text.replace('"better": 0', '"better": 0, "better": 1'))
    with pytest.raises(InputError, match='found key "better" twice'):
        read_plan(tmp_path / "plan.json")


@pytest.mark.parametrize(("name", "field", "value", "says"), ABSURD, ids=IDS)
def test_an_absurd_plan_is_told_in_one_sentence(
    tmp_path: Path, name: str, field: str, value: object, says: str
) -> None:
    path = tmp_path / "plan.json"
    write(path, changed(PLANS[name], field, value))
    with pytest.raises(InputError) as told:
        read_plan(path)
    sentence = str(told.value)
    assert sentence.startswith(f"{path}: ")
    assert says in sentence
    assert len(sentence) < 400
    assert "\n" not in sentence
    # Nothing of the kind is written, either.
    with pytest.raises(InputError, match="the plan found: "):
        plan_of(changed(PLANS[name], field, value))


COMMANDS = {
    "simulate": ("--plan", "plan.json", "--out", "mesh.glb"),
    "predict": ("--state", "start.obj", "--plan", "plan.json", "--out", "predicted"),
    "plan": ("--state", "start.obj", "--goal", "start.obj", "--after", "plan.json", "--out", "next.json"),
}


def refused(*arguments: object) -> str:
    """What a command says that refuses what it is given, does nothing, and leaves all files as they are."""
    before = {path: path.read_bytes() for path in Path.cwd().rglob("*") if path.is_file()}
    never = mock.Mock(side_effect=AssertionError("no step may run"))
    with (
        mock.patch.object(Worlds, "advance", never),
        mock.patch.object(simulate_command, "execute", never),
        mock.patch.object(predict_command, "predict_plan", never),
    ):
        result = run(*arguments)
    assert result.exit_code == 1, result.output
    assert isinstance(result.exception, SystemExit)
    assert {path: path.read_bytes() for path in Path.cwd().rglob("*") if path.is_file()} == before
    *done, sentence = result.stderr.splitlines()
    assert all(line.endswith(" s") for line in done)
    return sentence


@pytest.fixture
def earlier(here: Path) -> Path:
    """Outcomes of earlier calls."""
    (here / "predicted").mkdir()
    for name in ("mesh.glb", "next.json", "predicted/step_1_net_0.obj", "predicted/step_1_net_0.npz"):
        (here / name).write_text("of an earlier call")
    return here


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("table.axes", [[0, 0, 0]] * 3),
        ("table.origin_m", [1e6, 0, 0]),
        ("metres_per_normalised", 1e-3),
        ("steps.0.manipulation.4", 1000),
        ("steps.0.hands", []),
        ("steps.0.predictions.1.net", 0),
        ("system", "b2"),
    ],
)
def test_commands_refuse_absurd_plans_before_they_do_anything(
    earlier: Path, command: str, field: str, value: object
) -> None:
    write(earlier / "plan.json", changed(PLANS["b1"], field, value))
    sentence = refused(command, *COMMANDS[command])
    assert sentence.startswith(f"{command}: plan.json: ")
    assert sentence.count("expected") + sentence.count("input should be") == 1


@pytest.mark.parametrize("command", COMMANDS)
def test_a_plan_for_another_cloth_is_refused(earlier: Path, command: str) -> None:
    write(earlier / "plan.json", PLANS["b1"])
    sentence = refused(command, *COMMANDS[command], "--side", 0.5)
    assert sentence == f"{command}: --side: expected 0.4, for which plan.json was planned, found 0.5"


@pytest.mark.parametrize("size", [0.0, 0.1, 3.0])
def test_a_cloth_of_another_size_is_not_simulated(earlier: Path, size: float) -> None:
    """Not one that is crammed into a point, either: all of its vertices would touch each other."""
    plan = content("b1", vectors=(np.float32([0, 0, 0, 0, 0.6, 0.5]),))
    middle = np.array(plan["start"]["centre_m"])
    vertices = middle + size * (np.array(plan["start"]["state"]["vertices_m"]) - middle)
    grasped = changed(plan, "start.state.vertices_m", vertices.tolist())
    write(earlier / "plan.json", grasped)
    sentence = refused("simulate", *COMMANDS["simulate"])
    assert sentence.startswith(f"simulate: plan.json: start.state: the mesh's side is {0.4 * size:.3g} along its edges")


@pytest.mark.parametrize("command", ["predict", "plan"])
def test_a_plan_of_other_nets_is_refused(earlier: Path, command: str) -> None:
    """The nets under data are as they are trained by then: net 0 is the best one, of latent width 8."""
    write(earlier / "plan.json", changed(PLANS["b1"], "memory.best", 1))
    assert "memory.best: is net 1, but of the nets in data net 0 is the best" in refused(command, *COMMANDS[command])
    for members in ((0,), (1, 0), (0, 1, 2)):
        write(earlier / "plan.json", content("b1", members=members))
        sentence = refused(command, *COMMANDS[command])
        assert f"plan.json: was planned with nets {', '.join(map(str, members))}, expected 0, 1" in sentence
    write(earlier / "plan.json", content("b2", members=(1,)))
    assert "memory.best: is net 1, but of the nets in data net 0 is the best" in refused(command, *COMMANDS[command])
    write(earlier / "plan.json", changed(PLANS["b1"], "memory.traces_before", [[[0.0] * 3] * 8] * 2))
    assert "memory.traces_before: has shapes [(8, 3), (8, 3)]" in refused(command, *COMMANDS[command])


def test_predictions_are_replaced_together_or_not_at_all(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(here / "plan.json", content("b1"))
    asked = ("predict", *COMMANDS["predict"])
    succeed(*asked)
    before = {path.name: path.read_bytes() for path in (here / "predicted").iterdir()}
    assert set(before) == {
        f"step_{n}_net_{net}.{ending}" for n in (1, 2) for net in (0, 1) for ending in ("obj", "npz")
    }
    original, count = predict_command.write_arrays, [0]

    def full(*arguments: Any) -> None:
        count[0] += 1
        if count[0] == 3:
            raise OSError(28, "No space left on device")
        original(*arguments)

    monkeypatch.setattr(predict_command, "write_arrays", full)
    write(here / "plan.json", changed(content("b1"), "memory.common", 3))
    sentence = refused_while_writing(asked)
    assert sentence == "predict: predicted: can't be written: no space is left; free some and run again"
    assert {path.name: path.read_bytes() for path in (here / "predicted").iterdir()} == before


def refused_while_writing(arguments: tuple[object, ...]) -> str:
    """The last line of what a command says that fails."""
    result = run(*arguments)
    assert result.exit_code == 1, result.output
    return result.stderr.splitlines()[-1]


def test_turned_plans_keep_their_decision_and_equal_errors_leave_either() -> None:
    expected = PLANS["b1"]["expected"]
    turned = changed(PLANS["b1"], "turned", [[0.0, -1.0], [1.0, 0.0]])
    same = changed(
        PLANS["b1"], "expected", {**expected, "error_no_action_cloth_lengths": 0.1, "error_no_action_m": 0.04}
    )
    for plan in (turned, same):
        for improves in (True, False):
            assert plan_of(changed(plan, "expected.improves", improves)).expected.improves == improves
    idle = changed(turned, "steps", [{**step, "null": True, "hands": []} for step in turned["steps"]])
    for step in idle["steps"]:
        step["manipulation"][4:] = [0.1, 0.1]
    with pytest.raises(InputError, match=r"expected\.improves: expected false"):
        plan_of(idle)


def test_a_plan_that_no_file_may_hold_is_not_written(tmp_path: Path) -> None:
    plan = plan_of(PLANS["b1"])
    expected = {"sides_m": None, "thickness_m": None, "limits": None, "table_in_camera": None, **PLANS["b1"]}
    expected |= {part: {**PLANS["b1"][part], "named": None, "unsure": None} for part in ("state", "goal")}
    unknown = dict.fromkeys(("outcome_error_m", "outcome_error_low_m", "outcome_error_high_m", "trust"))
    expected["expected"] = {
        "error_without_limits_m": None,
        "prediction_error_m": None,
        **unknown,
        **PLANS["b1"]["expected"],
    }
    assert json.loads(plan.model_dump_json()) == json.loads(json.dumps(expected))
    # As files were before hands were told apart.
    assert plan_of(changed(PLANS["b1"], "steps.0.hands.0.hand", ...)) == plan
    with pytest.raises(InputError, match=r"the plan found: expected\.loss: input should be a finite number, found nan"):
        plan_of(changed(PLANS["b1"], "expected.loss", float("nan")))
