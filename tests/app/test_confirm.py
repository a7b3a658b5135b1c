"""`clothkit plan --confirm`: what a goal is taken for is shown, and nothing is planned unless it is right."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result

from clothkit.app import confirm
from clothkit.app import plan as plan_command
from clothkit.app.cli import cli
from clothkit.cloth.topology import SQUARE
from clothkit.observation.camera import CameraConfig, render
from tests.app.test_plan import FOUND, toy_planner
from tests.observation.scenes import SCALE, folded
from tests.planning.test_lengths import finding

CAMERA = CameraConfig(columns=160, rows=120, focal=147.5)


@pytest.fixture
def wanted(here: Path, files: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, ...]:
    """A call with a depth image of a cloth that someone has folded as its goal."""
    monkeypatch.setattr(plan_command, "load_planner", toy_planner)
    image = render(folded(along=0.0).astype(float) * SCALE, SQUARE.triangles(), CAMERA)
    matrix = np.array([[147.5, 0, 79.5], [0, 147.5, 59.5], [0, 0, 1]])
    np.savez(here / "goal.npz", depth=image.depth.astype(np.float32), cloth=image.cloth, K=matrix)
    return ("plan", "--state", str(files / "bent.obj"), "--goal", "goal.npz", "--steps", "1", "--confirm")


def called(wanted: tuple[str, ...], answer: str) -> Result:
    with finding({1: FOUND[:1]}):
        return CliRunner().invoke(cli, list(wanted), input=answer)


def test_nothing_is_planned_if_it_is_not_the_goal(here: Path, wanted: tuple[str, ...]) -> None:
    for answer in ("n\n", ""):
        result = called(wanted, answer)
        assert result.exit_code == 1
        assert "Is this the goal? [y/N]" in result.stderr
        assert not (here / "plan.json").exists()


def test_what_is_shown_is_what_was_seen(here: Path, wanted: tuple[str, ...]) -> None:
    result = called(wanted, "y\n")
    assert result.exit_code == 0, result.output
    assert (here / "plan.json").exists()
    assert "plan.goal.png: the goal as it was seen, and what it is taken for" in result.stderr
    assert "silhouette IoU" in result.stderr
    picture = cv2.imread(str(here / "plan.goal.png"))
    assert picture is not None
    left, right = picture[:, : picture.shape[1] // 2], picture[:, picture.shape[1] // 2 :]
    # The cloth is folded in half: about a quarter of the panel's width by half of its height is dark.
    dark = (left.max(axis=2) < 215).mean()
    assert 0.1 < dark < 0.4
    assert right.std() > 5


def test_a_goal_that_a_camera_saw_is_asked_about_on_a_terminal(
    here: Path, files: Path, wanted: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    unsaid = wanted[:-1]
    result = called(unsaid, "")
    assert result.exit_code == 0, result.output
    assert "notice: goal.npz: what it is taken for is not confirmed (--confirm shows it, and asks)" in result.stderr
    monkeypatch.setattr(confirm, "on_terminal", lambda: True)
    (here / "plan.json").unlink()
    assert "Is this the goal? [y/N]" in called(unsaid, "n\n").stderr
    assert not (here / "plan.json").exists()
    quiet = called((*unsaid, "--no-confirm"), "")
    assert quiet.exit_code == 0, quiet.output
    assert "confirm" not in quiet.stderr
    # A mesh is what it is.
    known = called(tuple(str(files / "goal.glb") if word == "goal.npz" else word for word in unsaid), "")
    assert known.exit_code == 0, known.output
    assert "confirm" not in known.stderr


def test_a_named_or_a_known_goal_is_shown_too(here: Path, files: Path, wanted: tuple[str, ...]) -> None:
    known = tuple(str(files / "goal.glb") if word == "goal.npz" else word for word in wanted)
    result = called(known, "y\n")
    assert result.exit_code == 0, result.output
    assert "silhouette IoU" not in result.stderr
    assert (here / "plan.goal.png").exists()
