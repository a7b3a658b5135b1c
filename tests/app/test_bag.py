"""Bags, read back by the library's reader: what a robot is told is what the plan says, when it says it."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clothkit.app.bag import BEGINS_S, schedule
from clothkit.app.plan_file import Plan, plan_of
from tests.app import plans
from tests.app.conftest import run, succeed
from tests.observation.scenes import SMALL

CAMERA = SMALL.table().frame()
"""The table's axes and origin before a camera that looks down at it."""


def a_plan(**options: Any) -> Plan:
    return plan_of(plans.content(camera=CAMERA, **options))


def read_back(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """The times [ns] and messages of each topic."""
    highlevel = pytest.importorskip("rosbags.highlevel")
    found: dict[str, list[tuple[int, Any]]] = {}
    with highlevel.AnyReader([path]) as reader:
        for connection, time, content in reader.messages():
            message = reader.deserialize(content, connection.msgtype)
            found.setdefault(connection.topic, []).append((time, message))
    return found


def test_a_bag_tells_the_grippers_what_the_plan_says(here: Path) -> None:
    pytest.importorskip("rosbags")
    plan = a_plan()
    plans.write(here / "plan.json", plans.content(camera=CAMERA))
    said = succeed("bag", "--plan", "plan.json", "--out", "bag", "--steps", 2, "--grip", 0.5, "--pause", 2)
    assert said.startswith("bag: 2 hands, ")
    found = read_back(here / "bag")
    assert set(found) == {f"/clothkit/hand_{k}/{name}" for k in (1, 2) for name in ("pose", "closed")}
    first, second = plan.steps
    lasts = first.hands[0].waypoints[-1].time_s
    for number, hand in enumerate(first.hands, start=1):
        times, poses = zip(*found[f"/clothkit/hand_{number}/pose"][: 1 + len(hand.waypoints)], strict=True)
        # Half a second with the gripper open, half a second for it to close.
        expected = [BEGINS_S, *(BEGINS_S + 1 + point.time_s for point in hand.waypoints)]
        np.testing.assert_allclose(np.array(times) / 1e9, expected, atol=1e-9)
        stamps = [pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec for pose in poses]
        assert stamps == list(times)
        assert {pose.header.frame_id for pose in poses} == {"camera"}
        where = [[getattr(pose.pose.position, axis) for axis in "xyz"] for pose in poses]
        np.testing.assert_array_equal(where, [hand.grasp_m, *(point.position_m for point in hand.waypoints)])
        for pose in poses:
            turned = Rotation.from_quat([getattr(pose.pose.orientation, part) for part in "xyzw"])
            # The camera looks down as well.
            np.testing.assert_allclose(turned.apply([0, 0, 1]), [0, 0, 1], atol=1e-6)
            along = np.subtract(hand.release_m, hand.grasp_m) * [1, 1, 0]
            np.testing.assert_allclose(turned.apply([1, 0, 0]), along / np.linalg.norm(along), atol=1e-4)
        grips = [(time / 1e9, message.data) for time, message in found[f"/clothkit/hand_{number}/closed"]]
        np.testing.assert_allclose([time for time, _ in grips[:3]], BEGINS_S + np.array([0, 0.5, 1 + lasts]), atol=1e-9)
        assert [closed for _, closed in grips[:3]] == [False, True, False]
    # The second step has one hand, and begins when the first has let go and two seconds have passed.
    one, other = (found[f"/clothkit/hand_{number}/pose"] for number in (1, 2))
    assert (len(one), len(other)) == (2 * (1 + len(second.hands[0].waypoints)), 1 + len(first.hands[1].waypoints))
    assert one[len(one) // 2][0] / 1e9 == pytest.approx(BEGINS_S + 1 + lasts + 0.5 + 2)


def test_the_frame_of_the_poses_and_the_first_step_alone(here: Path) -> None:
    pytest.importorskip("rosbags")
    plans.write(here / "plan.json", plans.content())
    succeed("bag", "--plan", "plan.json", "--frame-id", "base_link")
    (of_one,) = [found for topic, found in read_back(here / "plan_bag").items() if topic == "/clothkit/hand_1/pose"]
    assert {message.header.frame_id for _, message in of_one} == {"base_link"}
    assert len(of_one) == 1 + len(a_plan().steps[0].hands[0].waypoints)
    again = run("bag", "--plan", "plan.json")
    assert again.exit_code == 1
    assert again.stderr.strip() == "bag: plan_bag: is there already, expected the name of a new folder"
    assert [path.name for path in here.iterdir() if path.name.startswith(".")] == []


def test_a_gripper_that_only_lifts_points_down_all_the_same() -> None:
    plan = plan_of(plans.content(vectors=(plans.ONE,)))
    hand = plan.steps[0].hands[0]
    up = hand.model_construct(grasp_m=(0.0, 0.0, 0.0), release_m=(0.0, 0.0, 0.1), waypoints=hand.waypoints)
    step = plan.steps[0].model_construct(**{**dict(plan.steps[0]), "hands": [up]})
    lifted = plan.model_construct(**{**dict(plan), "steps": [step]})
    (pose, *_), _ = schedule(lifted, steps=1, grip=1.0, pause=1.0)[1]
    matrix = Rotation.from_quat(pose.orientation).as_matrix()
    np.testing.assert_allclose(matrix[:, 2], [0, 0, -1], atol=1e-9)
    assert np.linalg.det(matrix) == pytest.approx(1)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--plan", "none.json"), "none.json: not found"),
        (("--plan", "plan.json", "--steps", 3), "--steps: expected at most 2, the steps of plan.json, found 3"),
        (("--plan", "null.json"), "null.json: nothing is done in step 1, so there is no bag of it"),
        (("--plan", "plan.json", "--out", "no/where"), "no/where: no is no folder, it must be there"),
    ],
)
def test_bad_input_is_told_in_one_sentence(here: Path, arguments: tuple[object, ...], says: str) -> None:
    pytest.importorskip("rosbags")
    plans.write(here / "plan.json", plans.content())
    null = np.array([1, 1, 1, 1, -0.3, 0.3], np.float32)
    content = plans.content(vectors=(plans.ONE,))
    step = {**content["steps"][0], "manipulation": null.astype(float).tolist(), "null": True, "hands": []}
    expected = {**content["expected"], "improves": False}
    plans.write(here / "null.json", {**content, "steps": [step], "expected": expected})
    result = run("bag", *arguments)
    assert result.exit_code == 1
    assert result.stderr.strip() == f"bag: {says}" or says in result.stderr


def test_a_missing_library_is_told(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    plans.write(here / "plan.json", plans.content())
    result = run("bag", "--plan", "plan.json")
    assert result.exit_code == 1
    assert result.stderr.strip() == "bag: rosbags: is not installed, pip install 'clothkit[ros2]' installs it"
