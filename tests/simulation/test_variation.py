"""Cloths and starts that each sequence draws for itself: within their ranges, recorded, and the same in any order."""

import dataclasses
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
import pydantic
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE, Topology
from clothkit.dataset.regularise import RegulariseConfig, regularise
from clothkit.manipulation.named_folds import GOALS, manipulations, turned
from clothkit.manipulation.vector import is_null, is_single
from clothkit.simulation import variation
from clothkit.simulation.attempts import attempt_sequences, to_metres
from clothkit.simulation.executor import perform
from clothkit.simulation.generation import generate
from clothkit.simulation.quality import intersections
from clothkit.simulation.settings import (
    DRAWN,
    LEAST_SPACING,
    Limits,
    SimulateConfig,
    SimulationConfig,
    Starts,
    VariationConfig,
)
from clothkit.simulation.solver import flat_state
from clothkit.simulation.variation import draw, opening, script
from clothkit.simulation.world import Worlds

SIMULATION = SimulationConfig(side=16)
VARIATION = VariationConfig(
    thickness=(0.002, 0.008),
    density=(0.1, 0.6),
    stretch_stiffness=(1000.0, 4000.0),
    shear_stiffness=(1.0, 40.0),
    bending_stiffness=(1e-5, 2e-4),
    bending_limit=(30.0, 1000.0),
    cloth_friction=(0.2, 0.8),
    table_friction=(0.3, 1.0),
    squares=0.5,
    starts=Starts(flat=0.5, dragged=0.25, dropped=0.25),
)
LIMITS = Limits(height=1.0, intersections=10**6, gap=0.0, strain_p99=1.0, strain_worst=2.0)
SETTINGS = SimulateConfig(
    sequences=3, seed=1, block=1, workers=1, simulation=SIMULATION, limits=LIMITS, variation=VARIATION
)


@given(st.integers(0, 10**6), st.integers(0, 10**6))
def test_what_is_drawn_lies_in_its_range(seed: int, number: int) -> None:
    drawn = draw(SIMULATION, VARIATION, seed=seed, number=number)
    assert drawn == draw(SIMULATION, VARIATION, seed=seed, number=number)
    longer, shorter = drawn.topology.sides
    assert longer == CLOTH_LENGTH
    assert 1 <= longer / shorter <= 1.8
    assert drawn.topology.count == (8 if longer == shorter else 4)
    for name in DRAWN:
        low, high = getattr(VARIATION, name)
        assert low * (1 - 1e-9) <= getattr(drawn.simulation.material, name) <= high * (1 + 1e-9)
    # The solver takes it, however thick and narrow: else this raises.
    drawn.simulation.check(drawn.topology)


def test_shares_are_those_asked_for() -> None:
    drawn = [draw(SIMULATION, VARIATION, seed=0, number=number) for number in range(2000)]
    starts = Counter(one.start for one in drawn)
    for start, share in (("flat", 0.5), ("dragged", 0.25), ("dropped", 0.25)):
        assert starts[start] / len(drawn) == pytest.approx(share, abs=0.04)
    assert np.mean([one.topology.count == 8 for one in drawn]) == pytest.approx(0.5, abs=0.04)
    # Log-uniform: as many below the geometric mean as above it.
    stiff = np.array([one.simulation.material.bending_stiffness for one in drawn])
    assert np.mean(stiff < np.sqrt(1e-5 * 2e-4)) == pytest.approx(0.5, abs=0.04)


def test_a_narrow_cloth_is_only_as_thick_as_its_grid_allows() -> None:
    narrow = VariationConfig(thickness=(0.008, 0.008), squares=0.0, ratio=(1.8, 1.8))
    fine = SimulationConfig(side=32)
    drawn = draw(fine, narrow, seed=0, number=0)
    spacing = 0.4 / 1.8 / 31
    assert drawn.simulation.material.thickness == pytest.approx(spacing / LEAST_SPACING, rel=2e-3)


def test_without_a_range_nothing_varies() -> None:
    assert draw(SIMULATION, VariationConfig(), seed=3, number=5) == (SIMULATION, SIMULATION.topology, "flat")


def test_a_flat_start_needs_no_motion() -> None:
    drawn = draw(SIMULATION, VariationConfig(), seed=0, number=0)
    assert opening(drawn, VARIATION.starts, seed=0, number=0) is None


@pytest.mark.parametrize("start", ["dragged", "dropped"])
def test_a_hand_takes_a_vertex_along_its_path(start: str) -> None:
    starts = Starts(**{"flat": 0.0, start: 1.0})
    drawn = draw(SIMULATION, VariationConfig(starts=starts), seed=2, number=0)
    motion = opening(drawn, starts, seed=2, number=0)
    assert motion is not None
    flat = flat_state(drawn.simulation, drawn.topology)
    path, vertex = motion.path[0, 0], motion.held[0, 0, 0]
    np.testing.assert_allclose(path[0], flat.reshape(-1, 3)[vertex], atol=1e-7)
    moved, side = path[-1] - path[0], drawn.simulation.cloth_side
    if start == "dragged":
        assert 0.1 <= np.linalg.norm(moved[:2]) / side <= 0.5
        assert 0 < moved[2] < 0.05 * side
    else:
        assert 0.4 <= moved[2] / side <= 1.2
    # A cloth whose held vertex was moved, and let go, comes to rest as another shape, whole.
    done = Worlds(1, drawn.simulation, drawn.topology).execute(flat[None], motion)
    assert done.rested[0]
    assert np.abs(done.states[0] - flat).max() > 0.01
    assert intersections(done.states)[0] == 0


NAMED = dataclasses.replace(VARIATION, starts=Starts(), named=0.6)


@given(st.integers(0, 10**6), st.integers(0, 10**6))
def test_a_script_is_nearly_a_goal(seed: int, number: int) -> None:
    """It has the goal's hands, and moves as far as the goal does, less what cloth slides."""
    drawn = draw(SIMULATION, NAMED, seed=seed, number=number)
    found = script(drawn, 1.0, seed=seed, number=number)
    # Of a narrow cloth, a corner that goes in to the middle moves by less than a manipulation may.
    narrow = drawn.topology.sides[1] < 1.4
    assert found is not None or narrow
    if found is None:
        return
    folds = GOALS[found.goal].folds(drawn.topology)
    assert 1 <= len(found.manipulations) <= len(folds)
    assert len(found.manipulations) == len(folds) or narrow
    assert np.abs(found.manipulations[:, :4]).max() <= 1
    for fold, manipulation in zip(folds, found.manipulations, strict=False):
        assert is_single(manipulation) == (len(fold.grasps) == 1)
        assert not is_null(manipulation)
    turned_about = Topology(drawn.topology.shape, drawn.topology.sides[::-1], drawn.topology.symmetries)
    ways = [manipulations(seen, GOALS[found.goal].folds(seen))[:, 4:] for seen in (drawn.topology, turned_about)]
    moved = np.linalg.norm(found.manipulations[:, 4:], axis=1)
    exact = [np.linalg.norm(way, axis=1)[: len(moved)] for way in ways]
    assert any(((0.8 * way - 0.2 < moved) & (moved < way + 0.2)).all() for way in exact)


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize("mirrored", [False, True])
def test_folds_without_error_bring_edges_together(
    quarters: int, mirrored: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever side a half fold comes from, both hands hold the ends of an edge, and go to the opposite one."""
    monkeypatch.setattr(variation, "ASTRAY", 0.0)
    monkeypatch.setattr(variation, "REACHED", (1.0, 1.0))
    monkeypatch.setattr(variation, "GOALS", {"half": GOALS["half"]})
    narrow = VariationConfig(squares=0.0, ratio=(1.5, 1.5))
    drawn, found = draw(SIMULATION, narrow, seed=0, number=0), set()
    for number in range(40):
        told = script(drawn, 1.0, seed=0, number=number)
        assert told is not None
        u1, v1, u2, v2, dx, dy = told.manipulations[0]
        along_u = u1 == u2
        assert sorted([v1, v2] if along_u else [u1, u2]) == [-1, 1]
        expected = (-u1 * drawn.topology.sides[0], 0) if along_u else (0, -v1 * drawn.topology.sides[1])
        assert (dx, dy) == pytest.approx(expected)
        found.add((float(u1), float(v1), float(u2), float(v2)))
    assert len(found) == 8, "each of the four edges, and either hand first"
    exact = turned(manipulations(SQUARE, GOALS["half"].folds(SQUARE)), quarters=quarters, mirrored=mirrored)
    assert tuple(exact[0, :4]) in found


def test_the_shares_of_scripts_and_of_goals() -> None:
    drawn = draw(SIMULATION, NAMED, seed=0, number=0)
    found = [script(drawn, NAMED.named, seed=0, number=number) for number in range(2000)]
    goals = Counter(one.goal for one in found if one is not None)
    assert goals.total() / len(found) == pytest.approx(0.6, abs=0.04)
    assert set(goals) == set(GOALS)
    for count in goals.values():
        assert count / goals.total() == pytest.approx(1 / len(GOALS), abs=0.03)
    for start in ("dragged", "dropped"):
        assert script(drawn._replace(start=start), 1.0, seed=0, number=0) is None


def test_sequences_begin_with_folds_of_goals_and_tell_which(tmp_path: Path) -> None:
    raw = record(tmp_path, dataclasses.replace(SETTINGS, variation=NAMED, sequences=4))
    cloths = pd.read_parquet(raw / "cloths.parquet").set_index("sequence")
    moves = pd.read_parquet(raw / "manipulations.parquet").set_index(["sequence", "step"])
    told = {}
    for sequence in cloths.index:
        number = int(moves.at[(sequence, 0), "attempt"])
        told[sequence] = script(draw(SIMULATION, NAMED, seed=1, number=number), NAMED.named, seed=1, number=number)
    assert {None} < {one and one.goal for one in told.values()}, "some are scripted, some are not"
    for sequence, one in told.items():
        assert (cloths.at[sequence, "goal"] if one else None) == (one and one.goal)
        assert one or pd.isna(cloths.at[sequence, "goal"])
        for step, expected in enumerate(one.manipulations[:3] if one else ()):
            found = moves.loc[(sequence, step), ["u1", "v1", "u2", "v2", "dx", "dy"]].to_numpy(float)
            np.testing.assert_allclose(found[4:], expected[4:], atol=1e-6)
            if step == 0:  # of a flat cloth; later, another layer may lie above the point
                np.testing.assert_allclose(found[:4], expected[:4], atol=1 / 15 + 1e-6)
    dataset = regularise(raw, RegulariseConfig(train=2, validation=1, test=1, evaluated=1))
    assert dataset.length.tolist() == [3] * 4


def test_what_is_random_is_the_same_whatever_share_is_scripted() -> None:
    without = dataclasses.replace(NAMED, named=0.0)
    number = next(
        n for n in range(50) if script(draw(SIMULATION, NAMED, seed=1, number=n), 0.6, seed=1, number=n) is None
    )
    one, other = (
        attempt_sequences(range(number, number + 1), dataclasses.replace(SETTINGS, variation=each))
        for each in (NAMED, without)
    )
    for found, expected in zip(one, other, strict=True):
        np.testing.assert_array_equal(found, expected)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*.parquet"))}


def record(folder: Path, settings: SimulateConfig) -> Path:
    generate(folder / "raw", settings, work=folder / "work", attributes={})
    return folder / "raw"


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("varied"), SETTINGS)


def test_what_was_drawn_is_written_with_each_sequence(raw: Path) -> None:
    cloths = pd.read_parquet(raw / "cloths.parquet").set_index("sequence")
    moves = pd.read_parquet(raw / "manipulations.parquet")
    attempt = moves.groupby("sequence")["attempt"].first()
    states = pd.read_parquet(raw / "states")
    topologies = pd.read_parquet(raw / "topologies.parquet").set_index("topology")
    for sequence, row in cloths.iterrows():
        drawn = draw(SIMULATION, VARIATION, seed=1, number=int(attempt[sequence]))
        assert row["start"] == drawn.start
        for name in DRAWN:
            assert row[name] == np.float32(getattr(drawn.simulation.material, name))
        topology = states.loc[states["sequence"] == sequence, "topology"]
        assert topology.nunique() == 1
        material = topologies.at[topology.iloc[0], "material"].reshape(-1, 2)
        assert row[["side_u", "side_v"]].tolist() == pytest.approx(np.ptp(material, axis=0))
        assert row["side_u"] / row["side_v"] == pytest.approx(np.divide(*drawn.topology.sides))


def test_cloths_of_all_ratios_become_grids_of_one_size(raw: Path) -> None:
    dataset = regularise(raw, RegulariseConfig(train=1, validation=1, test=1, evaluated=1))
    cloths = pd.read_parquet(raw / "cloths.parquet")
    metres = cloths[["side_u", "side_v", "thickness"]].to_numpy()
    np.testing.assert_allclose(dataset.cloth, metres * (CLOTH_LENGTH / 0.4), rtol=1e-6)
    for axis, side in ((2, 0), (3, 1)):
        lines = np.linalg.norm(np.diff(dataset.vertices, axis=axis), axis=-1).sum(axis)
        # Chords are shorter than the folded lines that they span, on a grid of 16 vertices a side by up to a seventh.
        longest = np.median(lines, axis=2).max(axis=1)
        np.testing.assert_array_less(0.85 * dataset.cloth[:, side], longest)
        np.testing.assert_array_less(longest, 1.03 * dataset.cloth[:, side])


def test_a_recorded_fold_of_any_cloth_is_repeated_to_the_last_bit(raw: Path) -> None:
    dataset = regularise(raw, RegulariseConfig(train=1, validation=1, test=1, evaluated=1))
    states, moves = pd.read_parquet(raw / "states"), pd.read_parquet(raw / "manipulations.parquet")
    cloths = dataset.cloths(np.arange(3))
    for sequence, step in ((0, 0), (1, 1), (2, 2)):
        own = states[states["sequence"] == sequence]["vertices"].tolist()
        before, after = (own[state].reshape(1, 16, 16, 3) for state in (step, step + 1))
        move = moves[(moves["sequence"] == sequence) & (moves["step"] == step)].iloc[0]
        uv = move[["u1", "v1", "u2", "v2"]].to_numpy(float).reshape(2, 2)
        vertices = np.rint((uv + 1) / 2 * 15).astype(int) @ [16, 1]
        points = before.reshape(-1, 3)[vertices, :2][None]
        displacement = to_metres(move[["dx", "dy"]].to_numpy(np.float32)[None], 0.4 / CLOTH_LENGTH)
        worlds = Worlds(1, *cloths.world(sequence, SIMULATION))
        _, outcome = perform(worlds, before, points, displacement, np.array([move["hands"] == 1]))
        np.testing.assert_array_equal(outcome.states, after)


def test_workers_and_blocks_change_nothing(raw: Path, tmp_path: Path) -> None:
    other = dataclasses.replace(SETTINGS, block=2, workers=2)
    assert contents(record(tmp_path, other)) == contents(raw)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"thickness": [0.005, 0.002]}, "thickness is from 0.005 to 0.002, expected the lower value first"),
        ({"ratio": [0.5, 1.0]}, "ratio is from 0.5, expected at least 1"),
        ({"density": [0.001, 0.2]}, "density"),
        ({"starts": {"flat": 0.0}}, "expected at least one share above 0"),
        ({"starts": {"drop": [1.0, 0.5]}}, "drop is from 1 to 0.5"),
    ],
)
def test_impossible_ranges_are_refused(wrong: dict, told: str) -> None:
    with pytest.raises(pydantic.ValidationError, match=told):
        pydantic.TypeAdapter(VariationConfig).validate_json(json.dumps(wrong))
