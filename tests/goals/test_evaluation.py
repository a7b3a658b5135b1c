"""Problems of named goals, what is made of them, and the rows that tell it."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from clothkit.cloth.mesh import error
from clothkit.cloth.silhouette import centre
from clothkit.cloth.symmetry import relabel
from clothkit.cloth.topology import SQUARE
from clothkit.dataset import tables
from clothkit.dataset.rows import write_rows
from clothkit.dataset.store import papers_cloths
from clothkit.episodes.record import Tasks
from clothkit.evaluation import arrays
from clothkit.goals import outcomes as outcomes_module
from clothkit.goals import problems as problems_module
from clothkit.goals.outcomes import Outcomes, for_any_labels, outcomes, planned, scripted
from clothkit.goals.problems import Problem, problems
from clothkit.goals.rows import measured, pictured, rows
from clothkit.goals.settings import EvaluateGoalsConfig, SourceName, StartName
from clothkit.goals.starts import Laid, cloth_of, cloths_of, start_of
from clothkit.goals.tidy import PICTURED, TABLE
from clothkit.goals.variants import lay
from clothkit.manipulation.named_folds import GOALS
from clothkit.planning.perception import KnownMeshes
from clothkit.runtime.errors import InputError
from clothkit.simulation.cloths import Cloths
from clothkit.simulation.quality import intersections
from clothkit.simulation.settings import SimulateConfig, SimulationConfig, VariationConfig
from tests.goals.test_variants import exact
from tests.planning import toy

AT = np.array([0.3, -0.2, 0.0], np.float32)
ANGLE = 0.4
COARSE = SimulateConfig(sequences=1, simulation=SimulationConfig(side=12, time_step=2e-3))


def problem(name: str = "half", start: StartName = "flat", repeat: int = 0) -> Problem:
    """A goal, folded exactly, of a square that lies flat somewhere on the table."""
    mesh = lay(SQUARE.flat(), ANGLE) + AT
    made = exact(name, SQUARE)
    hands = np.array([[-1, -1, -1, 1, 1.2, 0]], np.float32)
    made = made._replace(manipulations=np.repeat(hands, len(made.manipulations), axis=0))
    return Problem(name, start, repeat, mesh, ANGLE, made, SQUARE, Cloths(*papers_cloths(1)))


def outcome(some: list[Problem], meshes: list[np.ndarray]) -> Outcomes:
    return Outcomes(np.stack(meshes), np.zeros(len(some), np.int64), np.full(len(some), 0.1, np.float32))


def test_there_are_as_many_manipulations_as_a_goal_needs_and_three_from_a_heap() -> None:
    lengths = {(name, start): problem(name, start).length for name in GOALS for start in ("flat", "crumpled")}
    assert lengths["half", "flat"] == 1
    assert lengths["half", "crumpled"] == 3
    assert lengths["corners-in", "flat"] == lengths["corners-in", "crumpled"] == 4


def test_goal_and_flat_cloth_lie_as_the_cloth_lies() -> None:
    given = problem()
    np.testing.assert_allclose(centre(given.goal), 0, atol=0.01)
    np.testing.assert_allclose(given.flat, given.mesh, atol=0.01)
    assert float(error(given.goal, lay(exact("half", SQUARE).states[1], ANGLE), aligned=True)) < 0.01


@pytest.mark.parametrize("k", [0, 3])
def test_an_outcome_that_is_the_goal_has_no_error_wherever_it_lies_and_in_any_labels(k: int) -> None:
    given = problem()
    there = np.asarray(relabel(given.goal, k)) + AT
    found = measured(given, there, given.flat)
    assert found["error"] == pytest.approx(0, abs=1e-4)
    assert found["iou"] > 0.97
    moved = measured(given, there + np.array([0.7, 0, 0], np.float32), given.flat)
    assert moved["error"] == pytest.approx(0, abs=1e-4)
    # SoftGym's measure counts the way: 1.2 times half a cloth length, all else equal.
    other = measured(given, there + np.array([1.4, 0, 0], np.float32), given.flat)
    assert other["softgym"] - moved["softgym"] == pytest.approx(0.6, abs=0.15)


@pytest.mark.parametrize("k", range(8))
def test_folded_exactly_in_its_place_softgyms_measure_is_0_in_any_labels(k: int) -> None:
    given = problem()
    given = given._replace(mesh=np.asarray(relabel(given.mesh, k)))
    np.testing.assert_allclose(given.flattened, given.mesh, atol=0.01)
    outcome = np.asarray(relabel(lay(given.made.states[1], ANGLE) + AT, k))
    assert measured(given, outcome, given.flattened)["softgym"] < 0.02
    # Doing nothing: half the cloth has all its way to go.
    assert measured(given, given.mesh, given.flattened)["softgym"] == pytest.approx(0.5, abs=0.03)


def test_rows_and_pictures_are_as_declared(tmp_path: Path) -> None:
    some = [problem("half"), problem("corners-in", "crumpled"), problem("half", repeat=1)]
    done = outcome(some, [each.goal + AT for each in some])
    script = outcome(some[:1], [some[0].mesh])
    evaluated: Any = [("mesh", some, done), ("script", some[:1], script)]
    found = rows(evaluated)
    write_rows(tmp_path / "goals.parquet", found, {})
    read = tables.read(tmp_path / "goals.parquet", TABLE)
    assert read["goal"].tolist() == ["half", "corners-in", "half", "half"]
    assert read["system"].fillna("").tolist() == ["b1", "b1", "b1", ""]
    assert read["length"].tolist() == [1, 4, 1, 1]
    assert (read["error"][:3] < 1e-3).all()
    assert read["error"][3] == pytest.approx(read["error_no_action"][3])
    assert (read["error_no_action"] > 0.1).all()
    arrays.save(tmp_path / "goals.zarr", pictured(evaluated), PICTURED, {})
    shown = arrays.load(tmp_path / "goals.zarr", PICTURED)
    # Of the first repeat alone.
    assert len(shown["goal"]) == 3
    np.testing.assert_allclose(shown["outcome"][0], shown["target"][0], atol=0.02)


def test_the_script_turns_with_the_cloth() -> None:
    asked = []

    def execute(meshes: np.ndarray, grasps: np.ndarray, moves: np.ndarray, single: np.ndarray, cloths: Cloths) -> Any:
        asked.append((grasps, moves, single))
        return meshes

    some = [problem("half"), problem("quarter")]
    found = scripted(some, execute)
    assert [len(moves) for _, moves, _ in asked] == [2, 1]
    turn = np.array([[np.cos(ANGLE), -np.sin(ANGLE)], [np.sin(ANGLE), np.cos(ANGLE)]])
    grasps, moves, single = asked[0]
    corners = np.array([[-0.7, -0.7], [-0.7, 0.7]]) @ turn.T + AT[:2]
    np.testing.assert_allclose(grasps[0], corners, atol=0.01)
    np.testing.assert_allclose(moves[0], turn @ [1.2, 0], atol=1e-5)
    assert not single.any()
    np.testing.assert_allclose(found.mesh[0], some[0].flat, atol=1e-6)


def test_more_manipulations_than_a_session_has_are_planned_in_two(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each session moves the cloth by 0.1 per manipulation, and does not execute its first one."""
    asked = []

    def run_sessions(tasks: Tasks, planner: Any, execute: Any, *, sensor: Any, refined: bool) -> SimpleNamespace:
        asked.append(tasks)
        length = np.array([task.length for task in tasks.task])
        moved = tasks.centre[:, None] + 0.1 * np.arange(4)[:, None]
        state = np.repeat(tasks.start[:, None], 4, axis=1)
        null = np.arange(3) < np.ones((len(length), 1))
        expected = np.full((len(length), 3), 0.1 * len(asked), np.float32)
        return SimpleNamespace(length=length, state=state, centre=moved, null=null, expected=expected)

    monkeypatch.setattr(outcomes_module, "run_sessions", run_sessions)
    some = [problem("half"), problem("corners-in")]
    found = planned(some, toy.planner("b1"), toy.execute, None)
    lengths = [[(task.start, task.length) for task in tasks.task] for tasks in asked]
    assert lengths == [[(0, 1), (0, 3)], [(3, 1)]]
    np.testing.assert_allclose(asked[1].centre, asked[0].centre[1:] + 0.3, atol=0.01)
    moved = (found.mesh - np.stack([each.mesh for each in some])).mean((1, 2))[:, :2]
    np.testing.assert_allclose(moved, [[0.1, 0.1], [0.4, 0.4]], atol=0.01)
    assert found.nulls.tolist() == [1, 2]
    np.testing.assert_allclose(found.expected, 0.1)
    # Other searches than those of other problems, whichever there are.
    assert asked[0].task[1].sequence == asked[1].task[0].sequence != asked[0].task[0].sequence


def test_goals_are_reached_in_any_labels() -> None:
    planner = for_any_labels(toy.planner("b1"))
    assert isinstance(planner.perception, KnownMeshes)
    assert not planner.perception.labelled
    assert not planner.labelled


def test_what_is_finished_is_not_done_again(tmp_path: Path) -> None:
    some = [problem("half"), problem("half", "crumpled"), problem("half", repeat=1)]
    calls = []

    def execute(meshes: np.ndarray, *rest: Any) -> np.ndarray:
        calls.append(len(meshes))
        return meshes

    sources: tuple[SourceName, ...] = ("script",)
    first = outcomes(some, sources, {}, execute, work=tmp_path)
    # From flat cloths alone, a repeat at a time.
    assert calls == [1, 1]
    again = outcomes(some, sources, {}, execute, work=tmp_path)
    assert calls == [1, 1]
    assert [[each.start for each in chosen] for _, chosen, _ in first] == [["flat"], ["flat"]]
    np.testing.assert_array_equal(first[0][2].mesh, again[0][2].mesh)


def test_starts_are_clean_lie_at_some_angle_and_are_the_same_again() -> None:
    settings = EvaluateGoalsConfig()
    flat, dragged = (start_of(0, name, settings, COARSE).mesh for name in ("flat", "dragged"))
    np.testing.assert_array_equal(flat, start_of(0, "flat", settings, COARSE).mesh)
    assert np.ptp(flat[..., 2]) < 1e-6
    # Turned: no edge is along x or y.
    along = flat[1:, 0, :2] - flat[:-1, 0, :2]
    assert np.abs(along).min() > 1e-3
    assert np.linalg.norm(along, axis=-1) == pytest.approx(1.4 / 11, rel=1e-3)
    assert intersections(dragged[None]).tolist() == [0]
    moved = np.linalg.norm(np.diff(dragged, axis=0), axis=-1)
    assert moved.max() > 1.4 / 11
    other = start_of(1, "flat", settings, COARSE).mesh
    assert np.abs(other - flat).max() > 0.05


def test_each_repeat_has_a_cloth_of_its_own_where_cloths_vary() -> None:
    settings = EvaluateGoalsConfig()
    assert cloth_of(0, settings, COARSE) == cloth_of(1, settings, COARSE)
    varied = dataclasses.replace(COARSE, variation=VariationConfig(thickness=(0.002, 0.004), squares=0.0))
    first, second = (cloth_of(repeat, settings, varied) for repeat in (0, 1))
    assert first.topology != second.topology
    simulation, topology = cloths_of(first, 2).world(1, COARSE.simulation)
    assert topology.sides == pytest.approx(first.topology.sides, rel=1e-6)
    assert simulation.material.thickness == pytest.approx(first.simulation.material.thickness, rel=1e-6)


def test_goals_that_a_cloth_can_not_have_are_left_out_and_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(problems_module, "start_of", lambda *_: Laid(lay(SQUARE.flat(), ANGLE)))
    refused = InputError("goal eighth, fold 3: no try left this cloth clean (intersections)")
    monkeypatch.setattr(
        problems_module,
        "made_all",
        lambda wanted, folder, **_: [exact(name, SQUARE) if name != "eighth" else refused for name, _, _ in wanted],
    )
    settings = EvaluateGoalsConfig(goals=("half", "eighth"), starts=("flat", "crumpled"), repeats=2)
    simulate = SimulateConfig(sequences=1)
    found = problems(settings, simulate, work=tmp_path, goals=tmp_path / "goals")
    assert [(each.name, each.start, each.repeat) for each in found] == [
        ("half", start, repeat) for repeat in (0, 1) for start in ("flat", "crumpled")
    ]
    assert all(each.angle == pytest.approx(ANGLE, abs=1e-4) for each in found)
    assert "notice: repeat 1: goal eighth, fold 3: no try left this cloth clean" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"goals": ("halve",)}, "goals has 'halve', expected some of half, triangle"),
        ({"starts": ("flat", "flat")}, "starts has something twice"),
        ({"starts": ("rolled",)}, "flat"),
        ({"repeats": 0}, "repeats"),
    ],
)
def test_impossible_settings_are_refused(wrong: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        EvaluateGoalsConfig(**wrong)
