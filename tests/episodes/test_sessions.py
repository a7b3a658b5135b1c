"""Sessions in the toy world: goals are reached, nothing is done where nothing helps, and an interrupted run goes on."""

import dataclasses
import tracemalloc
from pathlib import Path
from typing import Any
from unittest import mock

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import zarr

from clothkit.cloth.mesh import distance_aligned, error
from clothkit.cloth.silhouette import centred
from clothkit.cloth.symmetry import relabel
from clothkit.cloth.topology import SQUARE
from clothkit.dataset.store import SPLITS, Dataset, papers_cloths
from clothkit.dataset.tasks import Task
from clothkit.episodes import record
from clothkit.episodes.evaluate import TIMED_SESSIONS, cost, evaluate
from clothkit.episodes.record import Pieces, Tasks, join, load, save, save_piece, sizes_of, tasks_of_dataset
from clothkit.episodes.sensors import Sensed
from clothkit.episodes.sessions import run_sessions
from clothkit.evaluation.session_rows import rows
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.perception import Expected, KnownMeshes
from clothkit.planning.planner import Planner
from clothkit.planning.types import Found, Observation, Problem
from clothkit.runtime.errors import InputError
from clothkit.runtime.resumable import load_piece
from tests.planning import toy

MANIPULATIONS = np.array([[-1, -1, -1, -1, 0.6, 0.5], [1, 1, 1, 1, -0.7, -0.3], [-1, 1, -1, 1, 0.5, -0.6]], np.float32)


def dataset(sequences: int = 2) -> Dataset:
    """Recorded sequences of the toy world, one of them with the cloth elsewhere on the table."""
    vertices, centres = [], []
    for s in range(sequences):
        state = toy.bent() + np.array([0.3 * s, -0.2 * s, 0], np.float32)
        states = [centred(state)]
        for manipulation in MANIPULATIONS:
            state = np.asarray(toy.dragged(jnp.asarray(state), jnp.asarray(manipulation)))
            states.append(centred(state))
        vertices.append([mesh for mesh, _ in states])
        centres.append([middle for _, middle in states])
    every = np.ones(sequences, np.int8)
    return Dataset(
        np.array(vertices, np.float32),
        np.array(centres, np.float32),
        np.repeat(MANIPULATIONS[None], sequences, axis=0),
        np.ones((sequences, 3), np.int8),
        3 * every,
        np.full(sequences, SPLITS.index("test"), np.int8),
        every.astype(bool),
        *papers_cloths(sequences),
    )


def tasks(*chosen: Task) -> Tasks:
    return tasks_of_dataset(dataset(), list(chosen), "test")


def finding(plan: np.ndarray) -> Any:
    """In place of searches: as if they found the last steps of a plan, whatever they are asked."""

    def search(planner: Planner, problems: Problem, keys: Any, *, length: int) -> Found:
        tasks = len(problems.state)
        size = (tasks, *planner.settings.search.optimiser.shape(length))
        return Found(
            plan=jnp.broadcast_to(plan[-length:], (tasks, length, 6)),
            loss=jnp.zeros(tasks),
            terms={"accuracy": jnp.zeros((tasks, len(planner.nets)))},
            common=jnp.zeros(tasks, jnp.int32),
            relative=jnp.asarray(problems.relative),
            losses=jnp.zeros(size),
        )

    return mock.patch.object(Planner, "search", search)


def test_true_meshes_reach_the_goal_in_known_labels() -> None:
    sessions = run_sessions(tasks(Task(0, 0, 1), Task(1, 1, 1)), toy.planner("b1"), toy.execute)
    tidy = rows(sessions, "b1")
    # Eq. (13) with the planner's alpha.
    a, b, u = sessions.terms[:, 0].T
    np.testing.assert_allclose(sessions.loss[:, 0], a + b + 0.25 * u, rtol=1e-5)
    assert (tidy.error < 0.02).all()
    assert (tidy.error_labelled < 0.02).all()
    assert (tidy.error_no_action > 0.05).all()
    assert (sessions.relative[:, 0] == 0).all()
    # Not the recorded place on the table but the recorded shape: every state is centred.
    np.testing.assert_allclose(centred(sessions.state[1, 1])[1], 0, atol=0.02)
    assert np.isfinite(sessions.prediction_mean[:, 0, 0]).all()
    assert np.isnan(sessions.plan[:, 1:]).all()
    assert (tidy.voxel_error < 0.02).all()


def test_hands_go_where_the_cloth_was_seen() -> None:
    """A cloth that is seen off its centre is grasped as if it lay there."""
    off = np.array([0.2, -0.1], np.float32)
    grasped = []

    def sensor(truth: np.ndarray, expected: np.ndarray | None) -> Sensed:
        return Sensed(Observation(meshes=truth), np.repeat(off[None], len(truth), axis=0))

    def execute(meshes: np.ndarray, grasps: np.ndarray, *rest: np.ndarray) -> np.ndarray:
        grasped.append(grasps)
        return toy.execute(meshes, grasps, *rest)

    planner, given = toy.planner("b1"), tasks(Task(0, 0, 1), Task(1, 0, 1))
    run_sessions(given, planner, execute)
    run_sessions(given, planner, execute, sensor=sensor)
    np.testing.assert_allclose(grasped[1], grasped[0] + off, atol=1e-5)


def test_estimates_in_any_labels_reach_the_goals_shape() -> None:
    """Two steps, each observed in labels of its own as VtM may give them: later ones follow the prediction's."""
    labels, later = {0: 5, 1: 6}, {0: 3}

    def sensor(truth: np.ndarray, expected: np.ndarray | None) -> Sensed:
        of = labels if expected is None else later
        found = [np.asarray(relabel(mesh, of[i])) for i, mesh in enumerate(truth)]
        return Sensed(Observation(meshes=np.stack(found)), np.zeros((len(found), 2), np.float32))

    planner = dataclasses.replace(toy.planner("main"), perception=KnownMeshes(labelled=False), labelled=False)
    given = tasks(Task(0, 0, 2), Task(1, 0, 1))
    sessions = run_sessions(given, planner, toy.execute, sensor=sensor)
    outcome = sessions.state[np.arange(2), sessions.length]
    errors, before = np.asarray(error(outcome, sessions.goal, aligned=True)), rows(sessions, "main").error_no_action
    assert (errors < 0.5 * before).all()
    assert not sessions.null[:, 0].any()
    # Labels are those that bring the goal under the estimate's.
    assert sessions.relative[:, 0].tolist() == [5, 6]
    # The labels that the first plan found stay.
    assert sessions.relative[0, 1] == sessions.relative[0, 0]
    np.testing.assert_allclose(sessions.estimate[0, 1], relabel(sessions.state[0, 1], labels[0]), atol=1e-5)


def test_nothing_is_done_where_nothing_helps() -> None:
    given = tasks(Task(0, 0, 2))
    given = given._replace(goal=given.start)
    calls = []

    def execute(*arguments: np.ndarray) -> np.ndarray:
        calls.append(arguments)
        return toy.execute(*arguments)

    sessions = run_sessions(given, toy.planner("b1"), execute)
    assert sessions.null[0, :2].all()
    tidy = rows(sessions, "b1")
    # What the check has cancelled was tried on the side, and would have been worse.
    assert len(calls) == tidy.nulls_fired[0]
    assert tidy.nulls_last[0] == tidy.nulls_helped[0] == sessions.cancelled[0, 1]
    for step in (1, 2):
        np.testing.assert_array_equal(sessions.state[0, step], sessions.state[0, 0])
        np.testing.assert_array_equal(sessions.estimate[0, min(step, 1)], sessions.estimate[0, 0])
    assert rows(sessions, "b1").nulls.tolist() == [2]
    assert rows(sessions, "b1").error.tolist() == pytest.approx([0])


def test_a_search_without_a_valid_plan_moves_nothing() -> None:
    """Then all losses are infinite, and the plan may be any, here a good one."""
    original = Planner.search

    def fruitless(planner: Planner, problems: Problem, keys: Any, *, length: int) -> Found:
        found = original(planner, problems, keys, length=length)
        return found._replace(losses=jnp.full_like(found.losses, jnp.inf))

    usual = run_sessions(tasks(Task(0, 0, 1)), toy.planner("b1"), toy.execute)
    assert not usual.null[0, 0]
    with mock.patch.object(Planner, "search", fruitless):
        sessions = run_sessions(tasks(Task(0, 0, 1)), toy.planner("b1"), toy.execute)
    np.testing.assert_array_equal(sessions.expected, usual.expected)
    assert sessions.null[0, 0]
    assert sessions.cancelled[0, 0]
    np.testing.assert_array_equal(sessions.state[0, 1], sessions.state[0, 0])


def test_a_second_search_is_given_the_first_ones_plan_and_traces() -> None:
    planner = toy.planner("b1")
    asked = []
    original = Planner.search

    def spy(planner: Planner, problems: Problem, keys: Any, *, length: int) -> Found:
        asked.append(problems)
        return original(planner, problems, keys, length=length)

    with mock.patch.object(Planner, "search", spy):
        sessions = run_sessions(tasks(Task(0, 0, 2)), planner, toy.execute)
    assert [problems.carried.shape[1] for problems in asked] == [2, 1]
    for step, problems in enumerate(asked[1:], start=1):
        assert problems.later.all()
        np.testing.assert_array_equal(problems.carried[0], sessions.plan[0, step - 1, 1 : 3 - step])
        # A toy trace counts the manipulations that were executed.
        assert (problems.traces[0][0] == (~sessions.null[0, :step]).sum()).all()
    assert (asked[1].relative == sessions.relative[0, 0]).all()


@pytest.mark.parametrize(("strengths", "cancelled"), [((-0.2, 2.2), False), ((1.0, -3.0), True)])
def test_the_null_check_goes_by_the_mean_of_all_nets(strengths: tuple[float, float], cancelled: bool) -> None:
    """Their mean reaches the goal where either net alone would do worse than nothing, and the other way round."""
    planner = dataclasses.replace(toy.planner("b1"), nets=tuple(map(jnp.float32, strengths)))
    given = tasks(Task(0, 0, 1))._replace(recorded=None)
    with finding(MANIPULATIONS[:1]):
        sessions = run_sessions(given, planner, toy.execute)
    assert sessions.null[0, 0] == sessions.cancelled[0, 0] == cancelled
    # What hands do is linear in the nets' strength.
    outcome = toy.dragged(jnp.asarray(given.start[0]), jnp.asarray(MANIPULATIONS[0]), np.mean(strengths))
    off = np.asarray(outcome) - given.goal[0]
    by_hand = np.linalg.norm(off - off.mean((0, 1)), axis=-1).mean() / 1.4
    assert sessions.expected[0, 0] == pytest.approx(by_hand, abs=1e-4)


def test_a_null_check_counts_what_it_cancelled() -> None:
    """Cancelled where the goal is reached already; the manipulation, tried on the side, leads away from it."""
    given = tasks(Task(0, 0, 1))
    given = given._replace(goal=given.start, recorded=None)
    with finding(MANIPULATIONS[:1]):
        sessions = run_sessions(given, toy.planner("b1"), toy.execute)
    assert sessions.cancelled[0, 0]
    outcome = centred(np.asarray(toy.dragged(jnp.asarray(given.start[0]), jnp.asarray(MANIPULATIONS[0]))))[0]
    away = min(float(distance_aligned(outcome, relabel(given.goal[0], k))) for k in range(8))
    assert sessions.error_otherwise[0, 0] == pytest.approx(away, abs=1e-3)
    assert away > 0.05
    assert np.isnan(sessions.loss_recorded).all()
    np.testing.assert_array_equal(sessions.state[0, 1], sessions.state[0, 0])


def test_the_next_state_is_expected_after_the_manipulation_that_is_executed() -> None:
    """By the nets' mean, and not where the whole plan would end; what they differ by makes it less sure."""
    planner = toy.planner("b1")
    given = tasks(Task(0, 0, 2))._replace(recorded=None)
    told = []

    def perceive(
        perception: KnownMeshes, observation: Observation, expected: Expected | None, cloth: np.ndarray
    ) -> np.ndarray:
        told.append(expected)
        np.testing.assert_array_equal(cloth, given.cloths.cloth)
        return observation.meshes

    with finding(MANIPULATIONS[:2]), mock.patch.object(KnownMeshes, "__call__", perceive):
        sessions = run_sessions(given, planner, toy.execute)
    assert not sessions.null[0, 0]
    assert told[0] is None
    start, fold = jnp.asarray(given.start[0]), jnp.asarray(MANIPULATIONS[0])
    each = np.stack([np.asarray(toy.dragged(start, fold, net)) for net in toy.NETS])
    assert told[1] is not None
    np.testing.assert_allclose(told[1].mean[0], each.mean(0), atol=1e-5)
    own = sessions.prediction_std[0, 0, 0].astype(float)
    np.testing.assert_allclose(told[1].std[0], np.sqrt((own**2).mean(0) + each.var(0)), rtol=2e-3)


def test_a_record_without_refined_predictions_lacks_nothing_else() -> None:
    with finding(MANIPULATIONS[:1]):
        whole, without = (
            run_sessions(tasks(Task(0, 0, 1)), toy.planner("b1"), toy.execute, refined=asked) for asked in (True, False)
        )
    assert np.isfinite(whole.refined[:, 0]).all()
    assert np.isnan(without.refined).all()
    for name in set(vars(whole)) - {"refined"}:
        np.testing.assert_array_equal(getattr(whole, name), getattr(without, name), err_msg=name)


def test_a_broken_simulation_is_told() -> None:
    with finding(MANIPULATIONS[:1]), pytest.raises(InputError, match="not finite"):
        run_sessions(tasks(Task(0, 0, 1)), toy.planner("b1"), lambda meshes, *_: meshes * np.nan)


def test_candidates_of_the_flat_cloth_are_its_corners() -> None:
    points = MESH.candidates(SQUARE.flat(), toy.planner("b1").grasping)
    assert sorted(points.tolist()) == [[-1, -1], [-1, 1], [1, -1], [1, 1]]
    disc = np.zeros((32, 32, 3), np.float32)
    angle, radius = np.linspace(0, 2 * np.pi, 32)[:, None], np.linspace(0, 0.6, 32)[None]
    disc[..., 0], disc[..., 1] = radius * np.cos(angle), radius * np.sin(angle)
    assert len(MESH.candidates(disc, toy.planner("b1").grasping)) >= 1


def test_an_interrupted_run_goes_on_to_the_same_rows(tmp_path: Path) -> None:
    # Sequences of one manipulation have one task each.
    data = dataset()
    data, planner = dataclasses.replace(data, length=np.ones_like(data.length)), toy.planner("b1")
    whole, seconds = evaluate(data, planner, toy.execute, work=tmp_path / "whole")
    calls = 0

    def killed(*arguments: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        if calls == 2:
            raise KeyboardInterrupt
        return toy.execute(*arguments)

    with pytest.raises(KeyboardInterrupt):
        evaluate(data, planner, killed, work=tmp_path / "broken")
    assert [p.name for p in (tmp_path / "broken").iterdir()] == ["sessions_000000"]
    done = tmp_path / "broken/sessions_000000"
    times = [path.stat().st_mtime_ns for path in sorted(done.iterdir())]
    resumed, _ = evaluate(data, planner, toy.execute, work=tmp_path / "broken")
    assert [path.stat().st_mtime_ns for path in sorted(done.iterdir())] == times
    pd.testing.assert_frame_equal(rows(whole.whole(), "b1"), rows(resumed.whole(), "b1"))
    # Two pieces of one task; the first search, which compiles, is not counted. In the other one, the copy that pads the
    # batch of two counts, because its search takes as long.
    assert cost(seconds)["plans"] == {"1": (2, pytest.approx(seconds["1"][1][1], abs=1e-3))}
    save(tmp_path / "a.zarr", whole, {"system": "b1"})
    save(tmp_path / "b.zarr", resumed, {"system": "b1"})
    files = [sorted(p for p in (tmp_path / f"{n}.zarr").rglob("*") if p.is_file()) for n in "ab"]
    assert [p.read_bytes() for p in files[0]] == [p.read_bytes() for p in files[1]]
    back = load(tmp_path / "a.zarr")
    np.testing.assert_array_equal(back.plan, whole.whole().plan)
    assert back.split.tolist() == ["test"] * 2
    assert len(join([back, back])) == 4


@pytest.mark.parametrize("name", ["sessions.npz", "seconds.json"])
def test_a_damaged_piece_is_told_by_its_folder(tmp_path: Path, name: str) -> None:
    sessions = record.record(tasks(Task(0, 0, 3)), [], sizes_of(toy.planner("b1")))
    seconds = {"1": [(2, 0.1)], "estimates": [(1, 0.2)]}
    TIMED_SESSIONS.save(tmp_path / "piece", (sessions, seconds))
    loaded, loaded_seconds = load_piece(tmp_path / "piece", TIMED_SESSIONS)
    np.testing.assert_array_equal(loaded.state, sessions.state)
    assert loaded_seconds == seconds
    path = tmp_path / "piece" / name
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(InputError, match=r"piece: what an earlier run left is damaged \(.*; delete this folder"):
        load_piece(tmp_path / "piece", TIMED_SESSIONS)


def test_memory_does_not_grow_with_the_number_of_tasks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record, "SHARD", 6)
    sessions = record.record(tasks(*[Task(0, 0, 3)] * 4), [], sizes_of(toy.planner("b1")))
    save_piece(tmp_path / "piece.npz", sessions)

    def peak(count: int) -> int:
        tracemalloc.start()
        save(tmp_path / f"{count}.zarr", Pieces([tmp_path / "piece.npz"] * count), {})
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    peak(2)
    assert peak(12) < 1.2 * peak(3)
    # By zarr itself: sessions that were never planned, and the same ones again, are not loaded.
    back = zarr.open_group(tmp_path / "12.zarr", mode="r")
    for name, values in vars(sessions).items():
        if name != "split":
            np.testing.assert_array_equal(back[name][:], np.concatenate([values] * 12))


def test_a_shard_of_zeros_is_written_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All tasks of the second shard are of the training split, whose code is zero: its file must be there, too."""
    monkeypatch.setattr(record, "SHARD", 2)
    sessions = run_sessions(tasks(Task(0, 0, 1), Task(1, 1, 1)), toy.planner("b1"), toy.execute)
    other = dataclasses.replace(sessions, split=np.array(["train"] * 2, "U10"))
    save(tmp_path / "sessions.zarr", [sessions, other], {})
    assert (tmp_path / "sessions.zarr/split/c/1").is_file()
    assert load(tmp_path / "sessions.zarr").split.tolist() == ["test", "test", "train", "train"]


def test_more_sequences_than_there_are_is_told(tmp_path: Path) -> None:
    planner = toy.planner("b1")
    planner = dataclasses.replace(planner, settings=dataclasses.replace(planner.settings, test=9))
    with pytest.raises(InputError, match="9 sequences"):
        evaluate(dataset(), planner, toy.execute, work=tmp_path)
