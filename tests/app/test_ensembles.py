"""Ensembles of one net and of three, from the nets in files to plans, sessions, records, rows and plan files."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from clothkit.app.describe import PlanRequest, describe, paths_of
from clothkit.app.inputs import Input, Settings
from clothkit.app.plan_arrays import check_nets, memory_of, traces_before
from clothkit.app.plan_file import read_plan, write_plan
from clothkit.app.planner import Planned, begin, decide, load_planner
from clothkit.app.settings import AppConfig
from clothkit.cloth.topology import PAPERS_CLOTH, SQUARE
from clothkit.dataset import tables
from clothkit.dataset.rows import write_rows
from clothkit.dataset.tasks import Task
from clothkit.episodes import record
from clothkit.episodes.record import Sessions, tasks_of_dataset
from clothkit.episodes.sessions import run_sessions
from clothkit.evaluation import tidy
from clothkit.evaluation.diagnosis import diagnosed
from clothkit.evaluation.session_rows import rows
from clothkit.manipulation.candidates import CandidateConfig
from clothkit.observation.observe import observe
from clothkit.observation.states import MeshState
from clothkit.observation.waypoints import MotionConfig
from clothkit.planning.objective import Weights
from clothkit.planning.optimisers.cem import CEMConfig
from clothkit.planning.optimisers.gradient import GradientConfig
from clothkit.planning.planner import Planner
from clothkit.planning.settings import PlanConfig
from clothkit.planning.systems import system
from clothkit.planning.types import Memory, Observation
from clothkit.runtime.errors import InputError
from clothkit.simulation.settings import SimulationConfig
from tests.planning import toy
from tests.tiny import write_nets
from tests.toy_dataset import dataset

SIDE = 0.42
ALPHA = 0.25
SEARCH = toy.searching(strains=8, base_iterations=2, iterations_per_step=0)


@pytest.fixture(scope="module", params=[(4,), (2, 0, 7)], ids=["one net", "three nets"])
def members(request: pytest.FixtureRequest) -> tuple[int, ...]:
    """Of the ensemble. The one of the lowest number has the best validation score."""
    return tuple(request.param)


@pytest.fixture(scope="module")
def folder(members: tuple[int, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder with the members' nets."""
    found = tmp_path_factory.mktemp("ensemble") / "data"
    write_nets(found, members)
    return found


def settings_of(members: tuple[int, ...]) -> Settings:
    """Searches that take no time."""
    plan = PlanConfig(test=1, train=0, search=SEARCH, together=1, batch=1)
    return Settings(AppConfig(), plan, Weights(ALPHA, 5.0, 1.25), CandidateConfig(), SimulationConfig(), members)


@pytest.fixture(scope="module")
def planner(folder: Path, members: tuple[int, ...]) -> Planner:
    """Of system b1, which estimates nothing, and so compiles least."""
    return load_planner(system("b1"), folder, settings_of(members))


@pytest.fixture(scope="module")
def sessions(planner: Planner) -> Sessions:
    """Of the only task of a sequence of one manipulation: a program is compiled for each length."""
    tasks = tasks_of_dataset(dataset(), [Task(0, 0, 1)], "test")
    return diagnosed(run_sessions(tasks, planner, toy.execute), tasks, planner)


def test_the_planner_has_the_nets_of_the_members(planner: Planner, members: tuple[int, ...]) -> None:
    assert planner.members == members
    assert len(planner.nets) == len(planner.objective(1).accuracy.spans or [()]) == len(members)
    assert members[planner.best] == min(members)
    assert ("uncertainty" in planner.objective(1).terms) == (len(members) > 1)


def test_the_record_has_all_nets_and_comes_back_from_its_store(
    sessions: Sessions, planner: Planner, tmp_path: Path
) -> None:
    nets = len(planner.nets)
    assert sessions.prediction_mean.shape == (1, 3, 3, nets, 32, 32, 3)
    assert np.isfinite(sessions.prediction_mean[0, 0, 0]).all()
    *accuracies, u = sessions.terms[0, 0]
    assert len(accuracies) == nets
    # Eq. (13) for K nets: accuracy terms times 2 / K; a single net's loss is its NLL (B2).
    factor = {1: 1, 3: 2 / 3}[nets]
    by_hand = factor * sum(accuracies) + planner.weights.alpha * u
    np.testing.assert_allclose(sessions.loss[0, 0], by_hand, rtol=1e-5)
    assert (u > 0) == (nets > 1)
    assert np.isfinite(sessions.loss_recorded).all()
    record.save(tmp_path / "sessions.zarr", [sessions], {"members": list(planner.members)})
    back = record.load(tmp_path / "sessions.zarr")
    for name, values in vars(sessions).items():
        np.testing.assert_array_equal(getattr(back, name), values)
    assert record.load_members(tmp_path / "sessions.zarr") == planner.members


def test_rows_have_a_term_for_each_net(sessions: Sessions, planner: Planner, tmp_path: Path) -> None:
    write_rows(tmp_path / "b1.parquet", rows(sessions, "b1"), {})
    found = tables.read(tmp_path / "b1.parquet", tidy.PLANNING)
    names = [name for name in found if name.startswith("accuracy_")]
    assert names == [f"accuracy_{net}" for net in range(len(planner.nets))]
    np.testing.assert_array_equal(found[[*names, "uncertainty"]], sessions.terms[:, 0])
    if len(names) == 1:
        np.testing.assert_array_equal(found["accuracy_0"], found["loss"])


def decided(planner: Planner) -> tuple[Planned, Memory, Memory]:
    """A decision for a flat cloth: the plan, and the memory before and after it."""
    before = begin(planner, toy.bent(), 1)
    return *decide(planner, Observation(meshes=SQUARE.flat()[None]), before, seed=3), before


def test_a_plan_file_says_all_that_a_later_plan_needs(planner: Planner, folder: Path, tmp_path: Path) -> None:
    planned, later, before = decided(planner)
    mesh = MeshState(SQUARE.flat(), np.zeros(2, np.float32), SIDE / 1.4)
    source = Input("start.obj", mesh, observe(mesh, cloth_side=SIDE), PAPERS_CLOTH)
    paths = paths_of(planner, planned, source.pose, MotionConfig())
    path = tmp_path / "plan.json"
    write_plan(
        path,
        describe(
            planner, planned, paths, PlanRequest(source, source, toy.bent(), None, (SIDE, SIDE), 0.002, 3, "table")
        ),
    )
    plan = read_plan(path)
    assert tuple(prediction.net for prediction in plan.steps[0].predictions) == planner.members
    assert (plan.expected.epistemic_uncertainty is None) == (len(planner.members) == 1)
    check_nets(plan, planner, folder, path)
    found = memory_of(plan, planner, before, traces_before(plan, planner, path), int(later.left[0]))
    np.testing.assert_allclose(found.rest, later.rest)
    assert found.relative == later.relative
    if not plan.steps[0].null and not planned.useless:
        np.testing.assert_allclose(found.expected, later.expected, atol=1e-5)
        # Traces are computed anew from the file's manipulations, whose digits are rounded.
        for ours, agents in zip(found.traces, later.traces, strict=True):
            np.testing.assert_allclose(ours, agents, atol=1e-4)


def test_an_optimiser_by_name_keeps_the_settings_that_are_its_own(folder: Path, members: tuple[int, ...]) -> None:
    settings = settings_of(members)
    own = GradientConfig(strains=7)
    search = dataclasses.replace(settings.plan.search, optimiser=own)
    settings = settings._replace(plan=dataclasses.replace(settings.plan, search=search))
    chosen = {
        name: load_planner(system("b1"), folder, settings, optimiser=name).settings.search.optimiser
        for name in (None, "gradient", "cem")
    }
    assert chosen == {None: own, "gradient": own, "cem": CEMConfig()}


def test_one_net_is_system_b2_and_the_best_net_of_three_is_too(
    planner: Planner, folder: Path, members: tuple[int, ...], tmp_path: Path
) -> None:
    alone = load_planner(dataclasses.replace(system("b1"), single=True), folder, settings_of(members))
    assert alone.members == (min(members),)
    write_nets(tmp_path / "data", (min(members),))
    same = load_planner(system("b1"), tmp_path / "data", settings_of((min(members),)))
    ours, other = (decided(one)[0] for one in (alone, same))
    for name in ("plan", "means", "stds", "loss", "expected"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(other, name))
    assert ours.differences is None


def test_wrong_members_are_one_sentence(folder: Path, members: tuple[int, ...], tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nets/pemd/9: not found, system b1 plans with it"):
        load_planner(system("b1"), folder, settings_of((*members, 9)))
    write_nets(tmp_path / "data", (5, 6))
    (tmp_path / "data/normalisation/mesh.json").write_bytes((folder / "normalisation/mesh.json").read_bytes())
    count = len(members)
    with pytest.raises(InputError, match=rf"mesh\.json: expected reference values of 2 nets, .* of {count};"):
        load_planner(system("b1"), tmp_path / "data", settings_of((5, 6)))
