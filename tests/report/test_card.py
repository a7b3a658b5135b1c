"""The card of made-up raw artifacts: its numbers by brute force, its code, equal bytes, artifacts that lack much."""

import dataclasses
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from clothkit.cloth.topology import SQUARE
from clothkit.report.card import tables
from clothkit.report.card.build import build
from clothkit.report.card.inputs import MEASURED, read
from clothkit.report.card.meanings import meanings
from clothkit.report.card.measures import highest, limits
from clothkit.report.card.page import in_words
from clothkit.report.card.settings import CardConfig
from clothkit.simulation.arcsim import import_runs
from clothkit.simulation.arcsim_runs import read_runs
from clothkit.simulation.settings import SimulateConfig
from tests.simulation import arcsim_runs

SETTINGS = CardConfig(sequences=2, worst=1)
ATTRIBUTES = (
    b'{"stage": "simulate", "scale": "smoke", "params": {"limits": {"height": 0.125, "strain_p99": 0.06, '
    b'"gap": 0.4}, "simulation": {"side": 32, "cloth_side": 0.4, "material": {"thickness": 0.002}}}}'
)
REASONS = ["", "intersections", "", "too high", "", "no manipulation"]
REACHED = [4, 3, 4, 4, 4, 2]


def write(path: Path, table: pd.DataFrame) -> None:
    """A parquet file with attributes."""
    arrow = pa.Table.from_pandas(table, preserve_index=False)
    pq.write_table(arrow.replace_schema_metadata({b"clothkit": ATTRIBUTES}), path)


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three sequences of six attempts: cloths that shrink, random measures."""
    rng = np.random.default_rng(0)
    folder = tmp_path_factory.mktemp("root") / "data/raw"
    (folder / "states").mkdir(parents=True)
    measured = rng.uniform(0, 0.25, (6, 4, len(MEASURED))).astype(np.float32)
    shape = rng.uniform(0.2, 1, (6, 4)).astype(np.float32), rng.integers(0, 9, (6, 4)).astype(np.int32)
    settle = rng.uniform(0, 2, (6, 3)).astype(np.float32)
    until = np.arange(4) < np.array(REACHED)[:, None]
    attempts = pd.DataFrame({"attempt": range(6), "seed": 0, "accepted": [r == "" for r in REASONS]})
    attempts = attempts.assign(reason=REASONS, states=np.array(REACHED, np.int32))
    for name, values in zip(("area", "folds"), shape, strict=True):
        attempts[name] = list(np.where(until, values, 0))
    for k, name in enumerate(MEASURED):
        attempts[name] = list(np.where(until, measured[..., k], np.float32(np.nan)))
    attempts["settle_time"] = list(np.where(until[:, 1:], settle, np.float32(np.nan)))
    write(folder / "attempts.parquet", attempts)
    material = (SQUARE.geodesic().reshape(-1, 2) + 1) * 0.2
    states, steps = [], []
    for sequence, attempt in enumerate((0, 2, 4)):
        for state in range(4):
            flat = np.concatenate([material * (1 - 0.15 * state), np.full((1024, 1), 0.001)], axis=1)
            measures = dict(zip(MEASURED, measured[attempt, state], strict=True))
            vertices = flat.astype(np.float32).ravel()
            states.append({"sequence": sequence, "state": state, "topology": 0, "vertices": vertices, **measures})
        for step in range(3):
            move = {"u1": -1.0, "v1": -1.0, "u2": 1.0, "v2": -1.0, "dx": 0.3, "dy": 0.5 + 0.1 * step}
            known = {"attempt": attempt, "settle_time": settle[attempt, step]}
            steps.append({"sequence": sequence, "step": step, "hands": 1 + (step > 0), **move, **known})
    write(folder / "states/0000.parquet", pd.DataFrame(states[:8]))
    write(folder / "states/0001.parquet", pd.DataFrame(states[8:]))
    write(folder / "manipulations.parquet", pd.DataFrame(steps))
    topology = {"topology": [0], "material": [material.ravel()], "triangles": [SQUARE.triangles().ravel()]}
    write(folder / "topologies.parquet", pd.DataFrame(topology))
    cloths = {"sequence": range(3), "start": "flat", "side_u": 0.4, "side_v": 0.4, "thickness": 0.002}
    write(folder / "cloths.parquet", pd.DataFrame(cloths))
    return folder


@pytest.fixture(scope="module")
def card(raw: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Their card."""
    folder = tmp_path_factory.mktemp("card")
    build(folder / "card", raw, SETTINGS)
    return folder / "card"


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def values(raw: Path, name: str, state: int, *, accepted: bool) -> np.ndarray:
    """A measure of every accepted or tried state, straight from the attempts' lists."""
    table = pd.read_parquet(raw / "attempts.parquet")
    chosen = [row for row in table.to_dict("records") if row["states"] > state and (row["accepted"] or not accepted)]
    return np.array([row[name][state - (name == "settle_time")] for row in chosen], float)


def test_the_numbers_are_those_of_the_files(raw: Path, card: Path) -> None:
    for file, accepted in (("quality", True), ("quality_tried", False)):
        table = pd.read_csv(card / f"tables/{file}.csv")
        measures = (
            ("height [normalised]", "height", 1),
            ("gap between layers [mm]", "gap", 1000),
            ("settle time [s]", "settle_time", 1),
        )
        for title, name, factor in measures:
            for state in (1, 2, 3):
                row = table[(table["measure"] == title) & (table["step"] == state)].iloc[0]
                sample = factor * values(raw, name, state, accepted=accepted)
                worst = sample.min() if name == "gap" else sample.max()
                expected = [len(sample), *np.percentile(sample, [50, 5, 95]), worst]
                found = row[["states", "median", "5 %", "95 %", "worst"]].to_numpy(float)
                np.testing.assert_allclose(found, expected, rtol=1e-4)
        limits = table.groupby("measure")["limit"].first()
        assert limits["height [normalised]"] == 0.125
        assert limits["strain, 99th percentile [%]"] == pytest.approx(6)
        assert limits["gap between layers [mm]"] == pytest.approx(0.8)  # stated as a share of the thickness
        assert np.isnan(limits["residual speed [mm/s]"])
    differ = pd.read_csv(card / "tables/against_tried.csv").set_index(["measure", "step"])
    for title, name in (("folds", "folds"), ("silhouette area [flat cloth's]", "area")):
        accepted, tried = (np.median(values(raw, name, 2, accepted=only)) for only in (True, False))
        assert differ.loc[(title, 2), "difference [%]"] == pytest.approx(100 * (accepted / tried - 1), rel=1e-4)
    higher = pd.read_csv(card / "tables/viewport.csv")["higher"].tolist()
    assert higher == [(values(raw, "height", state, accepted=False) > 0.125).sum() for state in (1, 2, 3)]
    outcomes = pd.read_csv(card / "tables/outcomes.csv").set_index("outcome")
    assert outcomes["attempts"].to_dict() == {"accepted": 3, "intersections": 1, "no manipulation": 1, "too high": 1}
    assert outcomes.loc["intersections", "at step 2"] == 1
    assert outcomes.loc["no manipulation", "at step 2"] == 1
    assert outcomes.loc["too high", "at step 3"] == 1
    hands = pd.read_csv(card / "tables/hands.csv").set_index("step")
    assert hands["single-handed"].to_dict() == {"1": 3, "2": 0, "3": 0, "all": 3}


def test_states_are_too_high_by_the_datasets_own_limit(raw: Path) -> None:
    tried = read(raw).tried
    assert highest(limits({"limits": {"height": 0.2}})) == 0.2
    assert highest(limits({})) == 0.125
    counted = [int((tried.loc[tried["state"] == state, "height"] > 0.2).sum()) for state in (1, 2, 3)]
    assert 0 < sum(counted) < tables.viewport(tried, 0.125)["higher"].sum()
    assert tables.viewport(tried, 0.2)["higher"].tolist() == counted


def test_gaps_have_no_one_limit_where_thickness_is_drawn() -> None:
    told = {"limits": {"gap": 0.4}, "simulation": {"material": {"thickness": 0.002}}}
    assert limits(told)["gap"] == pytest.approx(0.0008)
    assert limits({**told, "variation": {"thickness": None}})["gap"] == pytest.approx(0.0008)
    assert "gap" not in limits({**told, "variation": {"thickness": [0.002, 0.008]}})


def test_worst_states_are_the_worst_that_are_left(raw: Path) -> None:
    states = read(raw).states
    worst = tables.worst(states, count=2)
    assert len(worst) == len(worst[["sequence", "state"]].drop_duplicates()) == 9  # there are no more
    assert (worst["state"] > 0).all()
    first = worst.iloc[0]
    folded = states[states["state"] > 0]
    assert first["measure"] == "strain_worst"
    assert first["value"] == folded["strain_worst"].max()
    for name, sign in (("gap", 1), ("height", -1)):
        shown = worst[worst["measure"] == name]
        ranks = (sign * folded[name]).rank(method="first").astype(int)
        for _, row in shown.iterrows():
            own = (folded["sequence"] == row["sequence"]) & (folded["state"] == row["state"])
            assert ranks[own].tolist() == [row["rank"]]


def test_the_page_is_complete_and_its_code_runs(raw: Path, card: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = contents(card)
    page = found["README.md"].decode()
    for target in re.findall(r"\]\((\w+/[^)]+)\)", page):
        assert target in found
    for part in ("states/0000", "manipulations", "attempts", "topologies"):
        for column in pq.read_schema(raw / f"{part}.parquet").names:
            assert re.search(rf"\| `{column}` \|.*\S+ \|$", page, re.MULTILINE), column
    assert "The cloth is a square of 0.4 m with 32 x 32 vertices" in page
    assert "Friction" not in page  # these artifacts don't state it
    block = re.search(r"```python\n(.*?)```", page, re.DOTALL)
    assert block is not None
    monkeypatch.chdir(raw.parents[1])
    names: dict[str, object] = {}
    exec(block[1], names)
    np.testing.assert_allclose(np.ptp(np.asarray(names["after_one"]), axis=0), [0.34, 0.34, 0], atol=1e-6)
    assert list(np.asarray(names["how"], float)) == pytest.approx([-1, -1, 1, -1, 0.3, 0.5])


def test_drawn_cloths_are_told_by_their_ranges(raw: Path) -> None:
    inputs = read(raw)
    drawn = {"thickness": [0.002, 0.008], "cloth_friction": [0.2, 0.8], "table_friction": [0.3, 1.0]}
    params = {**inputs.params, "variation": drawn}
    words = in_words(dataclasses.replace(inputs, attributes={**inputs.attributes, "params": params}))
    assert "squares and rectangles of 32 x 32 vertices whose longer side is 0.4 m" in words
    assert "Layers lie 0.002 to 0.008 m apart" in words
    assert "is a square" not in words


def test_equal_artifacts_give_equal_bytes(raw: Path, card: Path, tmp_path: Path) -> None:
    build(tmp_path / "again", raw, SETTINGS)
    assert contents(tmp_path / "again") == contents(card)


def test_artifacts_of_another_simulator_are_described_as_far_as_they_go(raw: Path, tmp_path: Path) -> None:
    """A topology per state, one to three manipulations, no measures, no lists of attempts, no attributes."""
    raw = shutil.copytree(raw, tmp_path / "raw")
    states = pd.read_parquet(raw / "states").drop(columns=["gap", "residual_speed"])
    moves = pd.read_parquet(raw / "manipulations.parquet").drop(columns=["attempt", "settle_time"])
    states = states[states["state"] <= states["sequence"] + 1].reset_index(drop=True)
    moves = moves[moves["step"] <= moves["sequence"]]
    states = states.assign(topology=np.arange(len(states)), height=np.nan, strain_p99=np.nan, strain_worst=np.nan)
    topology = pd.read_parquet(raw / "topologies.parquet")
    topology = topology.loc[[0] * len(states)].assign(topology=np.arange(len(states)))
    (raw / "states/0001.parquet").unlink()
    states.to_parquet(raw / "states/0000.parquet")
    moves.to_parquet(raw / "manipulations.parquet")
    topology.to_parquet(raw / "topologies.parquet")
    attempts = pd.DataFrame({"accepted": [True] * 3, "reason": [""] * 3, "states": [2, 3, 4]})
    # What isn't known of an attempt may also be there as no list, or as a list of nothing that counts.
    attempts = attempts.assign(height=None, area=[[np.nan] * 4] * 3, folds=[[-1] * 4] * 3)
    attempts.to_parquet(raw / "attempts.parquet")
    build(tmp_path / "card", raw, SETTINGS)
    page = (tmp_path / "card/README.md").read_text()
    assert "**3 sequences** of 1 to 3 manipulations: **9 states**" in page
    assert "9 triangulations" in page
    assert "so 1 is 0.2857 m here" in page
    assert "Tried states" not in page
    assert "worst states" not in page
    quality = pd.read_csv(tmp_path / "card/tables/quality.csv").set_index(["measure", "step"])
    assert quality.loc[("intersections", 1), "states"] == 3
    assert quality.loc[("intersections", 3), "states"] == 1
    assert (quality.loc["height [normalised]", "states"] == 0).all()


def test_settings_of_a_solver_that_had_no_part_in_it_are_not_told(raw: Path) -> None:
    inputs = read(raw)
    params = {**inputs.attributes["params"], "source": "arcsim", "runs": "runs/folder", "sequences": 3}
    elsewhere = dataclasses.replace(inputs, attributes={"stage": "simulate", "params": params})
    assert in_words(elsewhere) == (
        "Made by stage *simulate*. The states come from arcsim, of the runs listed in `runs/folder/runs.csv`.\n"
    )
    assert "height" not in limits(elsewhere.params)
    own = dataclasses.replace(inputs, attributes={"params": {**params, "source": "own", "runs": ""}})
    assert own.params.keys() == {"limits", "simulation", "sequences"}


def test_settings_have_the_words_that_stand_beside_them() -> None:
    words = meanings(SimulateConfig)
    assert words["sequences"] == "accepted ones to be recorded"
    assert words["candidates.spacing"] == "Least distance between two corners."
    assert words["simulation.cloth_side"] == "m, the longer side of a cloth that is no square"
    assert words["limits.strain_worst"] == ""
    assert "simulation" not in words


def test_imported_runs_have_a_card(tmp_path: Path) -> None:
    """ARCSim's runs lack what our solver's attempts have: their lists are null."""
    folder = tmp_path / "runs"
    for seed, name in enumerate(("first", "second")):
        arcsim_runs.write_run(folder / name, {0: (0.4, 0.0), 1: (0.4, 0.0)}, seed=seed)
    arcsim_runs.write_table(folder, [[(name, 0), (name, arcsim_runs.FRAME)] for name in ("first", "second")])
    sequences = read_runs(str(folder), 2)
    attributes = {"stage": "simulate", "params": {"source": "arcsim", "runs": str(folder), "sequences": 2}}
    import_runs(tmp_path / "raw", sequences, work=tmp_path / "work", attributes=attributes)
    build(tmp_path / "card", tmp_path / "raw", SETTINGS)
    quality = pd.read_csv(tmp_path / "card/tables/quality.csv").set_index(["measure", "step"])
    assert quality.loc[("height [normalised]", 1), "states"] == 2
    assert (quality.loc["gap between layers [mm]", "states"] == 0).all()
    assert "Tried states" not in (tmp_path / "card/README.md").read_text()
