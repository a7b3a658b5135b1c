"""Recorded sequences: the same bytes for any number of workers and after an interruption, and exact replays."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from clothkit.cloth.topology import CLOTH_LENGTH, Topology, rectangle, triangles
from clothkit.dataset.raw import Topologies
from clothkit.dataset.regularise import Mesher
from clothkit.runtime.errors import InputError
from clothkit.simulation import generation, world
from clothkit.simulation.attempts import Attempts, folds, to_metres
from clothkit.simulation.executor import execute, grasp, perform
from clothkit.simulation.generation import BLOCKS, generate
from clothkit.simulation.settings import Limits, SimulateConfig, SimulationConfig
from clothkit.simulation.solver import flat_state
from clothkit.simulation.world import Worlds
from tests.pool import SerialPool
from tests.tiny import attempts

SIDE = 16
SIMULATION = SimulationConfig(side=SIDE)
# Folds of so coarse a cloth are bulky and tangled: only those that never came to rest are rejected.
LIMITS = Limits(height=1.0, intersections=10**6, gap=0.0, strain_p99=1.0, strain_worst=2.0)
SETTINGS = SimulateConfig(sequences=3, seed=4, block=1, workers=1, simulation=SIMULATION, limits=LIMITS)
SCALE = SIMULATION.cloth_side / CLOTH_LENGTH


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*.parquet"))}


def record(folder: Path, settings: SimulateConfig) -> Path:
    generate(folder / "raw", settings, work=folder / "work", attributes={"seed": settings.seed})
    return folder / "raw"


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("simulate"), SETTINGS)


def test_a_rectangle_is_recorded_and_read_back_as_its_own_grid(tmp_path: Path) -> None:
    topology = rectangle(1.6, shape=(12, 10))
    (tmp_path / "work").mkdir()
    settings = dataclasses.replace(SETTINGS, sequences=1)
    generate(tmp_path / "raw", settings, work=tmp_path / "work", attributes={}, topology=topology)
    states = pd.read_parquet(tmp_path / "raw" / "states")
    assert pd.read_parquet(tmp_path / "raw" / "attempts.parquet")["area"][0][0] == pytest.approx(1, abs=0.03)
    mesher = Mesher(Topologies(tmp_path / "raw"), topology)
    meshes = [mesher("here", 0, vertices) for vertices in states["vertices"]]
    np.testing.assert_allclose(meshes[0][..., :2], topology.flat()[..., :2], atol=1e-6)
    for mesh, vertices in zip(meshes, states["vertices"], strict=True):
        np.testing.assert_allclose(mesh * SCALE, vertices.reshape(12, 10, 3), atol=1e-6)
    # A hand takes a vertex, whose geodesic coordinates are written.
    moves = pd.read_parquet(tmp_path / "raw" / "manipulations.parquet")
    for name, last in (("u1", 11), ("v1", 9), ("u2", 11), ("v2", 9)):
        place = (moves[name].to_numpy() + 1) / 2 * last
        np.testing.assert_allclose(place, np.rint(place), atol=1e-5)


def test_the_artifacts_hold_what_the_design_says(raw: Path) -> None:
    states = pd.read_parquet(raw / "states" / "0000.parquet")
    assert states["sequence"].tolist() == [0] * 4 + [1] * 4 + [2] * 4
    assert states["state"].tolist() == [0, 1, 2, 3] * 3
    vertices = np.stack(states["vertices"]).reshape(-1, SIDE, SIDE, 3)
    assert vertices.dtype == np.float32
    np.testing.assert_array_equal(vertices[::4], np.stack([flat_state(SIMULATION)] * 3))
    np.testing.assert_allclose(states["height"], vertices[..., 2].max((1, 2)) * 3.5, rtol=1e-6)
    manipulations = pd.read_parquet(raw / "manipulations.parquet")
    assert manipulations["step"].tolist() == [0, 1, 2] * 3
    assert (np.hypot(manipulations["dx"], manipulations["dy"]) >= 0.49 - 1e-6).all()
    single = manipulations["hands"] == 1
    assert ((manipulations["u1"] == manipulations["u2"]) & (manipulations["v1"] == manipulations["v2"]) == single).all()
    topologies = pd.read_parquet(raw / "topologies.parquet")
    material = topologies["material"][0].reshape(-1, 2)
    assert np.ptp(material, axis=0) == pytest.approx([0.4, 0.4])
    np.testing.assert_array_equal(topologies["triangles"][0].reshape(-1, 3), triangles((SIDE, SIDE)))
    tried = pd.read_parquet(raw / "attempts.parquet")
    assert tried["accepted"].sum() == 3
    assert tried["accepted"].iloc[-1]
    assert ((tried["reason"] == "") == tried["accepted"]).all()
    assert tried["area"][0][0] == pytest.approx(1, abs=0.03)
    accepted = tried[tried["accepted"]]
    for name in ("height", "strain_p99", "strain_worst", "intersections", "gap", "residual_speed"):
        lists = np.stack(tried[name].tolist())
        assert lists.dtype == np.float32
        np.testing.assert_array_equal(np.isnan(lists).sum(1), 4 - tried["states"])
        np.testing.assert_array_equal(np.concatenate(accepted[name].tolist()), states[name])
    settled = np.stack(tried["settle_time"].tolist())
    np.testing.assert_array_equal(np.isnan(settled).sum(1), 4 - tried["states"])
    np.testing.assert_array_equal(np.concatenate(accepted["settle_time"].tolist()), manipulations["settle_time"])


def test_workers_and_blocks_change_nothing(raw: Path, tmp_path: Path) -> None:
    other = dataclasses.replace(SETTINGS, block=2, workers=2)
    assert contents(record(tmp_path, other)) == contents(raw)


def test_an_interrupted_run_goes_on(raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    attempted: list[int] = []
    stopped: list[bool] = []
    attempt_sequences = generation.attempt_sequences

    def interrupted(numbers: range, settings: SimulateConfig, topology: Topology) -> generation.Attempts:
        if len(attempted) == 2 and not stopped:
            stopped.append(True)
            attempted.clear()
            raise KeyboardInterrupt
        attempted.append(numbers[0])
        return attempt_sequences(numbers, settings, topology)

    monkeypatch.setattr(generation, "attempt_sequences", interrupted)
    with pytest.raises(KeyboardInterrupt):
        record(tmp_path, SETTINGS)
    assert contents(record(tmp_path, SETTINGS)) == contents(raw)
    assert attempted[0] == 2


def test_recorded_manipulations_replay_to_the_last_bit(raw: Path) -> None:
    states = pd.read_parquet(raw / "states").sort_values(["sequence", "state"])
    vertices = np.stack(states["vertices"]).reshape(-1, 4, SIDE, SIDE, 3)
    recorded = pd.read_parquet(raw / "manipulations.parquet")
    # In another order than recorded, all in one batch.
    before, after = vertices[:, :3].reshape(-1, SIDE, SIDE, 3)[::-1], vertices[:, 1:].reshape(-1, SIDE, SIDE, 3)[::-1]
    rows = recorded.iloc[::-1]
    uv = rows[["u1", "v1", "u2", "v2"]].to_numpy().reshape(-1, 2, 2)
    index = np.rint((uv + 1) / 2 * (SIDE - 1)).astype(int) @ [SIDE, 1]
    xy = np.take_along_axis(before.reshape(len(before), -1, 3), index[..., None], axis=1)[..., :2]
    moves = to_metres(rows[["dx", "dy"]].to_numpy(), SCALE)
    single = rows["hands"].to_numpy() == 1
    _, outcome = perform(Worlds(len(rows), SIMULATION), before, xy, moves, single)
    np.testing.assert_array_equal(outcome.states, after)


def test_execution_does_not_depend_on_workers(raw: Path) -> None:
    mesh = flat_state(SIMULATION) / np.float32(SCALE)
    meshes = np.stack([mesh] * 4)
    corners = np.array([[[-0.7, -0.7], [-0.7, 0.7]], [[-0.7, -0.7]] * 2, [[0.7, 0.7]] * 2, [[0.7, -0.7], [0.7, 0.7]]])
    moves = np.array([[1.3, 0.0], [0.7, 0.7], [-0.6, -0.7], [-1.0, 0.1]])
    single = np.array([False, True, True, False])
    one = execute(meshes, corners, moves, single, settings=SIMULATION, workers=1)
    two = execute(meshes, corners, moves, single, settings=SIMULATION, workers=2)
    np.testing.assert_array_equal(one, two)
    third = execute(meshes[2:3], corners[2:3], moves[2:3], single[2:3], settings=SIMULATION)
    np.testing.assert_array_equal(third[0], one[2])
    # Section 4.2.2: one hand is let go at the grasp point plus the displacement, close to where the corner then lies.
    np.testing.assert_allclose(one[1, 0, 0, :2], [0.0, 0.0], atol=0.12)


def test_a_hand_takes_the_topmost_vertex_and_keeps_it() -> None:
    mesh = flat_state(SIMULATION)
    mesh[3, 3] = [mesh[8, 8, 0] + 0.004, mesh[8, 8, 1], 0.005]
    within = SIMULATION.spacing(SIMULATION.topology)[0] / 2
    taken = grasp(mesh, mesh[8, 8, :2], within=within)
    assert taken == 3 * SIDE + 3
    assert grasp(mesh, mesh[3, 3, :2], within=within) == taken


def test_fold_count() -> None:
    flat = flat_state(SimulationConfig(side=20))
    assert folds(flat) == 0
    sheet = flat.copy()
    sheet[..., 0] = np.abs(flat[..., 0] - 0.05)
    sheet[..., 2] = np.where(flat[..., 0] > 0.05, 0.002, 0.0)
    assert folds(sheet) == 1


def test_limits_that_accept_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(generation, "HOPELESS", 1)
    impossible = dataclasses.replace(SETTINGS, limits=Limits(height=1e-3))
    with pytest.raises(InputError, match=r"simulate\.limits accepted none of 1 attempted sequences \(too high 1\);"):
        record(tmp_path, impossible)


def made_up(monkeypatch: pytest.MonkeyPatch, accepted: Callable[[int], bool]) -> list[int]:
    """Attempts take no time, and are accepted as told. Returns where the numbers of those that were made are added."""
    made: list[int] = []

    def attempt(numbers: range, settings: SimulateConfig, topology: Topology) -> Attempts:
        made.extend(numbers)
        found = np.array([accepted(number) for number in numbers])
        one = {name: np.repeat(array[:1], len(numbers), axis=0) for name, array in attempts(1)._asdict().items()}
        numbered = {"attempt": np.array(numbers), "accepted": found, "reason": np.where(found, "", "strained")}
        return Attempts(**{**one, **numbered})

    monkeypatch.setattr(generation, "attempt_sequences", attempt)
    return made


@pytest.mark.parametrize(
    ("wanted", "block", "workers", "most"),
    [
        (3, 4, 12, 2),  # if half of them are accepted
        (1, 1, 12, 2),
        (40, 4, 2, 13),  # no more than two for each worker ahead of the tenth
        (40, 1, 12, 45),
    ],
)
def test_no_more_blocks_are_begun_than_are_likely_to_be_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wanted: int, block: int, workers: int, most: int
) -> None:
    made = made_up(monkeypatch, lambda number: True)
    monkeypatch.setattr(generation, "open_pool", lambda kind, workers, scheduler: SerialPool(workers))
    settings = SimulateConfig(sequences=wanted, block=block, workers=workers)
    found = generate(tmp_path / "raw", settings, work=tmp_path / "work", attributes={})
    assert found.accepted == found.attempts == wanted
    assert made == list(range(len(made)))
    assert wanted <= len(made) <= most * block


def test_a_run_that_accepts_nothing_any_more_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(generation, "HOPELESS", 50)
    made = made_up(monkeypatch, lambda number: number in (0, 1))
    settings = SimulateConfig(sequences=3, block=4, workers=1)
    with pytest.raises(InputError, match=r"accepted none of the last 50 attempted sequences \(strained 50\)"):
        record(tmp_path, settings)
    assert len(made) == 52


def test_a_low_yield_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One in 60 after one in 9: more than 50 in a row, but fewer than 20 times 9."""
    monkeypatch.setattr(generation, "HOPELESS", 50)
    made_up(monkeypatch, lambda number: number in (8, 68, 128))
    found = generate(tmp_path / "raw", SimulateConfig(sequences=3, workers=1), work=tmp_path, attributes={})
    assert (found.accepted, found.attempts) == (3, 129)


def test_an_attempt_whose_budget_is_spent_is_rejected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world, "PATIENCE", 1e-6)
    monkeypatch.setattr(generation, "HOPELESS", 1)
    with pytest.raises(InputError, match=r"accepted none of 1 attempted sequences \(out of steps 1\)"):
        record(tmp_path, SETTINGS)


def test_a_stored_block_is_the_attempts(tmp_path: Path) -> None:
    BLOCKS.save(tmp_path / "block.npz", attempts(3))
    found = BLOCKS.load(tmp_path / "block.npz")
    for name, array in attempts(3)._asdict().items():
        np.testing.assert_array_equal(getattr(found, name), array)
        assert getattr(found, name).dtype == array.dtype
