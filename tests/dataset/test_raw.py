"""Raw tables with each fault, one by one: a sentence that names the file, the column and what was expected."""

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from clothkit.dataset import raw, tables
from clothkit.dataset.raw import ATTEMPTS, MANIPULATIONS, Topologies, read_manipulations, read_states
from clothkit.runtime.errors import InputError
from tests.dataset.test_regularise import write_raw

STATES = "states/0.parquet"
MOVES = "manipulations.parquet"
TOPOLOGIES = "topologies.parquet"


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_raw(tmp_path_factory.mktemp("healthy") / "raw", 3)


@pytest.fixture
def folder(healthy: Path, tmp_path: Path) -> Path:
    return shutil.copytree(healthy, tmp_path / "raw")


def read_all(folder: Path) -> None:
    """As `regularise` does."""
    states = read_states(folder / "states")
    read_manipulations(folder, states)
    topologies = Topologies(folder)
    for row in states.itertuples():
        topologies(f"{folder}: sequence {row.sequence}, state {row.state}", row.topology, row.vertices)


def table(name: str, change: Callable[[pd.DataFrame], pd.DataFrame]) -> Callable[[Path], None]:
    return lambda folder: change(pd.read_parquet(folder / name)).to_parquet(folder / name)


def cell(name: str, column: str, row: int, value: Any) -> Callable[[Path], None]:
    """Another value in one cell."""

    def change(rows: pd.DataFrame) -> pd.DataFrame:
        values = rows[column].tolist()
        values[row] = value
        return rows.assign(**{column: values})

    return table(name, change)


def scaled(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.assign(vertices=[1000 * vertices for vertices in rows["vertices"]])


def half_scaled(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.assign(vertices=[100 * vertices for vertices in rows["vertices"]])


def cut(folder: Path) -> None:
    (folder / MOVES).write_bytes((folder / MOVES).read_bytes()[:300])


FAULTS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "hands 300": (cell(MOVES, "hands", 4, 300), "column hands: expected whole numbers 1 to 2, found 300"),
    "hands null": (cell(MOVES, "hands", 4, None), "column hands: expected whole numbers 1 to 2, found double"),
    "hands text": (table(MOVES, lambda rows: rows.assign(hands="two")), "column hands: expected whole numbers 1 to 2"),
    "step 5": (
        cell(MOVES, "step", 2, 5),
        r"column step: expected whole numbers 0 to 2, found 5 \(sequence 0, step 5\)",
    ),
    "u1 5": (cell(MOVES, "u1", 1, 5.0), r"column u1: expected numbers -1\.001 to 1\.001, found 5"),
    "v2 NaN": (cell(MOVES, "v2", 1, np.nan), "column v2: expected numbers .*, found nothing"),
    "dx infinite": (cell(MOVES, "dx", 1, np.inf), "column dx: expected numbers -10 to 10, found inf"),
    "dy missing": (table(MOVES, lambda rows: rows.drop(columns="dy")), "has no column dy"),
    "step missing": (table(MOVES, lambda rows: rows.drop(index=3)), "sequence 1: expected steps from 0 on"),
    "last step missing": (
        table(MOVES, lambda rows: rows.drop(index=5)),
        "sequence 1: expected a manipulation from each state to the next, 3 of them, found 2",
    ),
    "step twice": (
        table(MOVES, lambda rows: pd.concat([rows, rows[:1]])),
        "expected one row for each sequence, step, found two for sequence 0, step 0",
    ),
    "sequence missing": (table(MOVES, lambda rows: rows[rows["sequence"] != 1]), "sequence 1: .* 3 of them, found 0"),
    "no rows": (table(MOVES, lambda rows: rows[:0]), "expected at least one row"),
    "cut": (cut, "can't be read as parquet"),
    "folder": (lambda folder: [(folder / MOVES).unlink(), (folder / MOVES).mkdir()], "manipulations.parquet"),
    "none": (lambda folder: (folder / MOVES).unlink(), "not found"),
    "millimetres": (
        table(STATES, scaled),
        r"column vertices: expected lists of numbers -100 to 100, found .*sequence 0",
    ),
    "centimetres": (table(STATES, half_scaled), r"state 0: vertices lie 40 m apart, expected at most 1\.13 m"),
    "kilometres": (
        table(STATES, lambda rows: rows.assign(vertices=rows["vertices"] / 1000)),
        r"sequence 0, state 0: edges are 1\.\d+e-05 m long .*, expected about 0\.0\d+ m, as in topology 0",
    ),
    "vertices null": (cell(STATES, "vertices", 3, None), r"column vertices: .* found nothing \(sequence 0, state 3\)"),
    "null in vertices": (
        cell(STATES, "vertices", 6, [0.0, None] * 1536),
        r"column vertices: .* found nan \(sequence 1, state 2\)",
    ),
    "NaN in vertices": (
        cell(STATES, "vertices", 6, np.full(3072, np.nan, np.float32)),
        r"column vertices: .* found nan \(sequence 1, state 2\)",
    ),
    "vertices short": (
        cell(STATES, "vertices", 6, np.zeros(3071, np.float32)),
        "has 3071 coordinates",
    ),
    "vertices text": (table(STATES, lambda rows: rows.assign(vertices="flat")), "column vertices: expected lists of"),
    "state 9": (cell(STATES, "state", 1, 9), "column state: expected whole numbers 0 to 3, found 9"),
    "state missing": (
        table(STATES, lambda rows: rows.drop(index=5)),
        "sequence 1: expected two to four states, from 0",
    ),
    "state twice": (table(STATES, lambda rows: pd.concat([rows, rows[:1]])), "found two for sequence 0, state 0"),
    "a state alone": (
        table(STATES, lambda rows: rows[(rows["sequence"] != 1) | (rows["state"] == 0)]),
        "sequence 1: expected two to four states",
    ),
    "other topology": (cell(STATES, "topology", 1, 7), r"its topology 7 is not in topologies\.parquet"),
    "topology twice": (
        table(TOPOLOGIES, lambda rows: pd.concat([rows, rows])),
        "expected one row for each topology, found two for topology 0",
    ),
    "strange vertex": (
        table(TOPOLOGIES, lambda rows: rows.assign(triangles=[np.array([0, 1, 4000])])),
        "topology 0: triangles: expected three numbers of vertices each, below 1024",
    ),
    "triangles of numbers": (
        table(TOPOLOGIES, lambda rows: rows.assign(triangles=[np.array([0.5, 1, 2])])),
        "column triangles: expected lists of whole numbers from 0 on, found list",
    ),
    "odd material": (
        table(TOPOLOGIES, lambda rows: rows.assign(material=[np.ones(2047)])),
        "topology 0: material has 2047 coordinates",
    ),
    "material in cm": (
        table(TOPOLOGIES, lambda rows: rows.assign(material=[100 * rows["material"][0]])),
        r"topology 0: material spans 40 x 40, expected 0\.01 to 20 m",
    ),
}


@pytest.mark.parametrize(("damage", "sentence"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_one_sentence(folder: Path, damage: Callable[[Path], Any], sentence: str) -> None:
    damage(folder)
    with pytest.raises(InputError, match=sentence) as told:
        read_all(folder)
    assert str(told.value).startswith(str(folder))
    assert len(str(told.value).splitlines()) == 1


def test_what_is_healthy_is_read_in_order(folder: Path) -> None:
    read_all(folder)
    rows = pd.read_parquet(folder / STATES)
    # Two files, their rows in any order, sequences of one and two manipulations, numbers left out.
    kept = rows[(rows["state"] <= rows["sequence"] + 1) & (rows["sequence"] < 2)]
    kept = kept.assign(sequence=3 * kept["sequence"]).sample(frac=1, random_state=0)
    kept[:2].to_parquet(folder / "states/1.parquet")
    kept[2:].to_parquet(folder / "states/0.parquet")
    moves = pd.read_parquet(folder / MOVES)
    moves = moves[(moves["step"] <= moves["sequence"]) & (moves["sequence"] < 2)]
    moves.assign(sequence=3 * moves["sequence"])[::-1].to_parquet(folder / MOVES)
    read_all(folder)
    states = read_states(folder / "states")
    assert states[["sequence", "state"]].to_numpy().tolist() == [[0, 0], [0, 1], [3, 0], [3, 1], [3, 2]]
    found = read_manipulations(folder, states)
    assert found[["sequence", "step"]].to_numpy().tolist() == [[0, 0], [3, 0], [3, 1]]
    assert read_states(folder / "states", sequences=[3])["state"].tolist() == [0, 1, 2]


def test_measures_may_be_missing_and_attempts_have_lists_of_them(tmp_path: Path) -> None:
    path = tmp_path / "attempts.parquet"
    lists = {"height": [[np.inf, np.nan], None], "area": [None, None], "folds": [[-1, 2], []], "gap": [[None], []]}
    rows = pd.DataFrame({"attempt": [3, 5], "accepted": [True, False], "reason": ["", "height"], "states": [2, 0]})
    rows.assign(**lists).to_parquet(path)
    assert len(tables.read(path, ATTEMPTS)) == 2
    for change, sentence in (
        ({"height": [0.1, 0.2]}, "column height: expected lists of numbers or nothing, found double"),
        ({"accepted": ["yes", "no"]}, "column accepted: expected true or false, found"),
        ({"reason": [None, "height"]}, r"column reason: expected text, found nothing \(attempt 3\)"),
        ({"attempt": [3, 3]}, "expected one row for each attempt, found two for attempt 3"),
    ):
        rows.assign(**{**lists, **change}).to_parquet(path)
        with pytest.raises(InputError, match=sentence):
            tables.read(path, ATTEMPTS)


def test_attributes_are_an_object(tmp_path: Path) -> None:
    path = tmp_path / "rows.parquet"
    for text, found in ((b'{"stage": "simulate"}', {"stage": "simulate"}), (None, {})):
        pq.write_table(pa.table({"a": [1]}).replace_schema_metadata({b"clothkit": text} if text else None), path)
        assert tables.read_attributes(path) == found
    for text in (b"[1]", b"{", b"\xff"):
        pq.write_table(pa.table({"a": [1]}).replace_schema_metadata({b"clothkit": text}), path)
        with pytest.raises(InputError, match=r"rows\.parquet"):
            tables.read_attributes(path)


def test_only_the_wanted_columns_are_read_and_optional_ones_as_far_as_they_are_there(folder: Path) -> None:
    found = tables.read(folder / MOVES, MANIPULATIONS, ("sequence", "step", "attempt"))
    assert list(found) == ["sequence", "step"]
    needed = dataclasses.replace(MANIPULATIONS.columns["attempt"], optional=False)
    asked = dataclasses.replace(MANIPULATIONS, columns={**MANIPULATIONS.columns, "attempt": needed})
    with pytest.raises(InputError, match="has no column attempt"):
        tables.read(folder / MOVES, asked, ("sequence", "step", "attempt"))
    assert set(raw.STATE_COLUMNS) <= set(raw.STATES_TABLE.columns)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda stored: stored.update(index_columns=["hands"]), "take column hands for an index"),
        (lambda stored: stored["columns"][0].pop("pandas_type"), "can't be read as parquet"),
    ],
)
def test_damaged_metadata_of_pandas_are_told(folder: Path, change: Callable[[dict], Any], sentence: str) -> None:
    found = pq.read_table(folder / MOVES)
    stored = json.loads(found.schema.metadata[b"pandas"])
    change(stored)
    pq.write_table(found.replace_schema_metadata({b"pandas": json.dumps(stored).encode()}), folder / MOVES)
    with pytest.raises(InputError, match=rf"manipulations\.parquet: .*{sentence}"):
        tables.read(folder / MOVES, MANIPULATIONS)
