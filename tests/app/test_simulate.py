"""The real simulator at the end of the command line: a half fold that a plan file tells is a half fold."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from clothkit.app.observables import input_of
from clothkit.app.options import observation_options
from clothkit.app.output import write_mesh
from clothkit.app.plan_file import read_plan
from clothkit.app.settings import AppConfig
from clothkit.app.simulate import score, simulated_material
from clothkit.observation.files import read
from clothkit.simulation.settings import SimulationConfig
from tests.app.conftest import AT, run, succeed
from tests.app.plans import content, write
from tests.observation.scenes import SMALL

HALF = np.array([1.0, -1.0, 1.0, 1.0, -1.38, 0.0], np.float32)


@pytest.mark.parametrize("frame", ["table", "camera"])
def test_a_half_fold_in_metres_away_from_the_origin(here: Path, files: Path, frame: str) -> None:
    write(here / "plan.json", content(vectors=(HALF,), camera=SMALL.table().frame() if frame == "camera" else None))
    assert len(read_plan(here / "plan.json").steps) == 1
    said = succeed("simulate", "--state", files / "start.obj", "--plan", "plan.json", "--goal", files / "goal.glb")
    outcome = read(here / "mesh.glb")
    metres = outcome.pose.normalised_to_table(outcome.mesh.astype(float))  # type: ignore[union-attr]
    # Let go at the other edge, the edge slides on by 3 cm, as it does in ARCSim (benchmarks/likeness.py, half fold).
    np.testing.assert_allclose(metres.min((0, 1))[:2], [AT[0] - 0.23, AT[1] - 0.2], atol=0.015)
    np.testing.assert_allclose(metres.max((0, 1))[:2], [AT[0], AT[1] + 0.2], atol=0.03)
    iou = float(said.split("silhouette IoU ")[1].split(",")[0])
    assert iou > 0.85
    too_many = run("simulate", "--plan", "plan.json", "--steps", 2)
    assert too_many.exit_code == 1
    assert too_many.stderr.strip() == "simulate: --steps: plan.json has 1, found 2"


def test_a_thick_rectangle_is_simulated_as_one(here: Path) -> None:
    sides, thickness = (0.5, 0.3), 0.005
    options = observation_options(AppConfig(), side=None, sides=sides)
    write_mesh(here / "towel.obj", options.topology.flat().astype(float) * options.scale + [*AT, 0])
    plan = content(side=sides[0], vectors=(HALF,), topology=options.topology)
    write(here / "plan.json", plan | {"sides_m": list(sides)})
    measured = ("--sides", *sides, "--thickness", thickness)
    succeed("simulate", "--state", "towel.obj", "--plan", "plan.json", *measured, "--out", "mesh.obj")
    outcome = trimesh.load_mesh(here / "mesh.obj", process=False).vertices
    assert np.ptp(outcome[:, 1]) == pytest.approx(0.3, abs=0.01)
    assert np.ptp(outcome[:, 0]) < 0.375
    # A quarter of the way up lies the lower layer, three quarters the upper one: as far apart as the towel is thick.
    lower, upper = np.quantile(outcome[:, 2], [0.25, 0.75])
    assert upper - lower == pytest.approx(thickness, rel=0.15)


def test_the_cloth_is_as_thick_as_the_grid_allows_and_a_notice_says_so() -> None:
    own = SimulationConfig()
    for sides, thickness, told in (
        ((0.4, 0.4), 0.002, ()),
        ((0.5, 0.28), 0.006, ()),
        ((0.5, 0.28), 0.009, ("9.0", "6.0")),
    ):
        options = observation_options(AppConfig(), side=None, sides=sides, thickness=thickness)
        found, notices = simulated_material(own, options.cloth, side=options.side)
        # Vertices that are 0.28 m / 31 apart allow two thirds of it.
        wanted = [f"a cloth of {asked} mm is simulated {able} mm thick" for asked, able in ([told] if told else [])]
        assert [notice.split(",")[0] for notice in notices] == wanted
        # A cloth of 0.5 m bends like one of 0.4 m that is softer by (4 / 5)^3.
        softer = (0.4 / sides[0]) ** 3
        assert found.material.bending_stiffness == pytest.approx(own.material.bending_stiffness * softer)


def test_a_rectangle_across_its_goal_is_far_from_it() -> None:
    """Labels of a cloth whose sides differ can't be exchanged; those of a square can."""
    for shorter, far in ((0.5, False), (0.4, True)):
        options = observation_options(AppConfig(), side=None, sides=(0.5, shorter))
        flat = options.topology.flat().astype(np.float32)
        found = score(flat, input_of(flat.astype(float) * options.scale, options, name="goal"), None)
        assert found.error == pytest.approx(0, abs=1e-4)
        turned = flat[..., [1, 0, 2]] * np.float32([1, -1, 1])
        found = score(turned, input_of(flat.astype(float) * options.scale, options, name="goal"), None)
        assert (found.error is not None and found.error > 0.3) == far
