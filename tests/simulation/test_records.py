"""Rectangles of many sizes in the raw artifacts: written in row groups, none of which overflows a list column."""

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from clothkit.cloth.topology import triangles
from clothkit.dataset.raw import Topologies
from clothkit.runtime.errors import InputError
from clothkit.simulation import records
from clothkit.simulation.attempts import Attempts
from clothkit.simulation.records import write_raw
from clothkit.simulation.solver import flat_grid

SHAPE = (4, 3)
SIDES = np.array([[0.4, 0.2], [0.4, 0.3], [0.5, 0.1], [0.4, 0.3], [0.6, 0.5], [0.3, 0.3]])
DISTINCT = np.array([[0.3, 0.3], [0.4, 0.2], [0.4, 0.3], [0.5, 0.1], [0.6, 0.5]])


def attempts() -> Attempts:
    """An accepted attempt for each pair of SIDES, whose states are its flat grid."""
    count = len(SIDES)
    flat = np.stack(
        [np.pad(flat_grid(SHAPE, tuple(sides)).reshape(*SHAPE, 2), ((0, 0),) * 2 + ((0, 1),)) for sides in SIDES]
    )
    shapes = {"material": (8,), "manipulation": (3, 6), "releases": (3, 2, 2)}
    shapes |= dict.fromkeys(("hands", "settle_time"), (3,))
    values = {name: np.zeros((count, *shapes.get(name, (4,)))) for name in Attempts._fields}
    texts = {"reason": np.array([""] * count), "start": np.array(["flat"] * count)}
    numbers = {"attempt": np.arange(count), "accepted": np.ones(count, bool), "reached": np.full(count, 4)}
    states = np.repeat(flat[:, None], 4, axis=1).astype(np.float32)
    return Attempts(**{**values, **texts, **numbers, "sides": SIDES, "states": states})


def write(folder: Path) -> Path:
    made = attempts()
    write_raw(folder, made, [made.states], seed=0, attributes={"stage": "simulate"})
    return folder


def test_many_rectangles_are_written_in_row_groups_and_read_as_one_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = write(tmp_path / "whole")
    monkeypatch.setattr(records, "TOGETHER", 2)
    parts = write(tmp_path / "parts")
    names = {path.name for path in whole.rglob("*.parquet")}
    assert len(names) == 5
    for path in whole.rglob("*.parquet"):
        same = path.read_bytes() == (parts / path.relative_to(whole)).read_bytes()
        assert same == (path.name != "topologies.parquet"), path
    metadata = pq.read_metadata(parts / "topologies.parquet")
    assert [metadata.row_group(k).num_rows for k in range(metadata.num_row_groups)] == [2, 2, 1]
    pd.testing.assert_frame_equal(*(pd.read_parquet(folder / "topologies.parquet") for folder in (whole, parts)))
    found = Topologies(parts)
    states = pd.read_parquet(parts / "states")
    for sides, (_, state) in zip(np.repeat(SIDES, 4, axis=0), states.iterrows(), strict=True):
        topology, _ = found("here", state["topology"], state["vertices"])
        np.testing.assert_allclose(np.ptp(topology.material, axis=0), sides, rtol=1e-6)
        np.testing.assert_array_equal(topology.triangles, triangles(SHAPE))
    # A million rectangles of one grid have one array of triangles.
    assert len({id(own) for own in found.rows["triangles"]}) == 1


def test_few_rectangles_have_the_bytes_of_a_table_written_at_once(tmp_path: Path) -> None:
    found = write(tmp_path / "raw") / "topologies.parquet"
    material = [flat_grid(SHAPE, tuple(sides)).ravel() for sides in DISTINCT]
    rows = {"topology": range(5), "material": material, "triangles": [triangles(SHAPE).ravel()] * 5}
    table = pa.table({name: list(values) for name, values in rows.items()}, schema=records.TOPOLOGIES)
    metadata = {"clothkit": '{"stage": "simulate"}'}
    pq.write_table(table.replace_schema_metadata(metadata), tmp_path / "at_once.parquet", compression="zstd")
    assert found.read_bytes() == (tmp_path / "at_once.parquet").read_bytes()


def test_a_number_in_two_row_groups_is_refused(tmp_path: Path) -> None:
    raw = write(tmp_path / "raw")
    rows = pq.read_table(raw / "topologies.parquet")
    with pq.ParquetWriter(raw / "topologies.parquet", rows.schema) as writer:
        for _ in range(2):
            writer.write_table(rows)
    with pytest.raises(InputError, match="expected one row for each topology, found two for topology 0"):
        Topologies(raw)
