"""Recordings of Rerun, read back by the library's reader: what a session shows, in metres, state by state."""

import sys
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
import viser

from clothkit.app.viewer import session as sessions
from clothkit.app.viewer.player import Player
from clothkit.app.viewer.recording import write_recording
from clothkit.cloth import voxels
from clothkit.cloth.silhouette import centred
from clothkit.observation.pose import Pose
from clothkit.observation.waypoints import MotionConfig, hand_paths
from tests.app import played
from tests.app.conftest import run
from tests.app.plans import finding
from tests.app.test_agent import metres, toy_agent
from tests.app.test_plan import FOUND
from tests.planning import toy
from tests.tiny import AT

SIDE, SCALE = 0.4, 0.4 / 1.4
CENTRES = (np.float32([0.3, -0.2]), np.float32([0.1, 0.1]), np.float32([0.0, 0.2]))
MOTION = MotionConfig(waypoints=5)


def read_back(path: Path) -> dict[str, list[tuple[dict[str, Any], dict[str, Any]]]]:
    """For each entity the times and the components of each row that is not empty."""
    chunk = pytest.importorskip("rerun.chunk")
    found: dict[str, list[tuple[dict[str, Any], dict[str, Any]]]] = {}
    for part in chunk.RrdReader(path).stream():
        batch = part.to_record_batch()
        columns = batch.to_pydict()
        for row in range(batch.num_rows):
            values = {name: column[row] for name, column in columns.items()}
            times = {name: values.pop(name) for name in part.timeline_names if name in values}
            kept = {name.split(":")[-1]: value for name, value in values.items() if value is not None}
            found.setdefault(part.entity_path, []).append((times, kept))
    return found


def values_of(rows: list[tuple[dict[str, Any], dict[str, Any]]], component: str) -> list[tuple[dict[str, Any], Any]]:
    """The times and values of one component, where it is there."""
    return [(times, values[component]) for times, values in rows if component in values]


def meshes(rows: list[tuple[dict[str, Any], dict[str, Any]]]) -> dict[int, np.ndarray]:
    """The vertices [m] that an entity has in each state."""
    return {times.get("state", 0): np.array(vertices) for times, vertices in values_of(rows, "vertex_positions")}


def test_a_session_is_recorded_in_metres_where_it_lies(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    session = played.session()._replace(centres=CENTRES)
    write_recording(tmp_path / "session.rrd", session, side=SIDE, motion=MOTION)
    assert [path.name for path in tmp_path.iterdir()] == ["session.rrd"]
    found = read_back(tmp_path / "session.rrd")
    cloth = meshes(found["/cloth"])
    assert sorted(cloth) == [0, 1, 2]
    for at, state in enumerate(session.states):
        expected = (state + np.append(CENTRES[at], 0)).reshape(-1, 3) * SCALE
        np.testing.assert_allclose(cloth[at], expected, atol=1e-6)
    (goal,) = meshes(found["/goal"]).values()
    np.testing.assert_allclose(goal, (session.goal + np.append(CENTRES[0], 0)).reshape(-1, 3) * SCALE, atol=1e-6)
    plan = session.steps[0].plan
    assert plan is not None
    predicted = {f"/predicted/net_{net}/after_{k}" for net in (0, 1) for k in (1, 2)}
    assert predicted <= set(found)
    np.testing.assert_allclose(
        meshes(found["/predicted/net_1/after_2"])[0],
        (plan.means[1, 1] + np.append(CENTRES[0], 0)).reshape(-1, 3) * SCALE,
        atol=1e-6,
    )
    # The hands follow the plan's first manipulation; the second plan's is null.
    pose = Pose(np.eye(3), np.zeros(3), CENTRES[0].astype(float) * SCALE, SCALE)
    paths = hand_paths(plan.manipulations[0], session.states[0], pose, MOTION)
    for number, points in enumerate(paths.points, start=1):
        rows = values_of(found[f"/hand_{number}"], "positions")
        np.testing.assert_allclose([times["time"].total_seconds() for times, _ in rows], paths.times, atol=1e-6)
        np.testing.assert_allclose(np.array([place for _, (place,) in rows]), points, atol=1e-3)
    assert any("loss 1" in values["text"][0] for _, values in found["/facts"])
    dots = next(dots for times, dots in values_of(found["/estimate/candidates"], "positions") if times["state"] == 0)
    assert len(dots) == len(played.CANDIDATES)


def test_voxels_are_recorded_as_boxes(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    session = played.session()
    plan = session.steps[0].plan
    assert plan is not None
    seen = np.asarray(voxels.observe(session.states[0])).astype(np.float32)
    plan = plan._replace(means=np.broadcast_to(seen, (2, 2, *seen.shape)), sigmas=None)
    estimate = sessions.StateEstimate(seen, None, 0.5 * played.CANDIDATES)
    steps = (session.steps[0]._replace(estimate=estimate, plan=plan), *session.steps[1:])
    write_recording(tmp_path / "session.rrd", session._replace(steps=steps), side=SIDE, motion=MOTION)
    found = read_back(tmp_path / "session.rrd")
    boxes = next(values for _, values in found["/estimate"] if "centers" in values)
    assert len(boxes["centers"]) == int((seen >= 0.5).sum())
    np.testing.assert_allclose(boxes["half_sizes"][0], np.array([1 / 32, 1 / 32, 0.125 / 32]) * SCALE, rtol=1e-5)


def test_an_agent_records_what_it_perceived_and_planned(here: Path) -> None:
    start = toy.bent()
    agent = toy_agent().begin(metres(start), steps=2)
    with finding(FOUND):
        for _ in range(2):
            # Nothing was done after the first plan: the cloth is observed and planned for anew.
            agent.observe(metres(start), executed=False)
            agent.plan()
    agent.observe(metres(start), executed=True)
    session = agent.session
    assert (len(session.states), len(session.steps), session.over) == (2, 2, False)
    assert [step.plan is not None for step in session.steps] == [True, False]
    with finding(FOUND):
        agent.plan()
    agent.observe(metres(start), executed=True)
    assert agent.session.over
    np.testing.assert_allclose(agent.session.centres[0] * SCALE, centred(start)[1] * SCALE + np.array(AT), atol=1e-5)
    pytest.importorskip("rerun")
    agent.record(here / "session.rrd")
    assert set(meshes(read_back(here / "session.rrd")["/cloth"])) == {0, 1, 2}


def test_the_page_keeps_every_session_that_it_shows() -> None:
    kept: list[sessions.Session] = []
    server = mock.MagicMock(spec=viser.ViserServer)
    server.gui, server.scene = mock.MagicMock(), mock.MagicMock()
    player = Player(server, keep=kept.append)
    with mock.patch.object(player, "_moved"), mock.patch("clothkit.app.viewer.player.assign"):
        player.show(played.session())
        player.show(played.session(), at=1)
    assert [session.title for session in kept] == ["made up", "made up"]


def test_what_is_missing_or_wrong_is_told(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rerun")
    wrong = run("view", "--record", "session.json")
    assert wrong.stderr.strip() == "view: session.json: ending '.json', expected rrd"
    monkeypatch.setitem(sys.modules, "rerun", None)
    missing = run("view", "--record", "session.rrd")
    assert missing.exit_code == 1
    assert missing.stderr.strip() == "view: rerun: is not installed, pip install 'clothkit[rerun]' installs it"
