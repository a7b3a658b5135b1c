"""Mutations of parquet tables and zarr stores."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.fuzzing.mutations import KINDS, REFUSED, SAME, Random, missing, mutation, truncated

_NUMBERS = (np.nan, np.inf, -np.inf, -1.0, 5.0, 300.0, 1e9, 1e300, 0.0)


def _column(table: pa.Table, random: Random) -> str:
    return str(table.column_names[int(random.integers(table.num_columns))])


def _rewritten(path: Path, change: Callable[[pa.Table], tuple[pa.Table, str]]) -> str:
    table, said = change(pq.read_table(path))
    pq.write_table(table, path)
    return said


def _set(table: pa.Table, name: str, column: pa.Array) -> pa.Table:
    return table.set_column(table.column_names.index(name), name, column)


@mutation("parquet")
def _column_of_another_kind(path: Path, random: Random) -> str:
    def change(table: pa.Table) -> tuple[pa.Table, str]:
        name, count = _column(table, random), table.num_rows
        columns = {
            "nulls": pa.nulls(count),
            "words": pa.array(["word"] * count),
            "true": pa.array([True] * count),
            "lists": pa.array([[1.0]] * count),
            "empty lists": pa.array([[]] * count, pa.list_(pa.float32())),
            "huge": pa.array([2**62] * count),
            "dates": pa.array([0] * count, pa.timestamp("s")),
            "bytes": pa.array([b"\xff"] * count),
            "records": pa.array([{"a": 1}] * count),
        }
        kind = list(columns)[int(random.integers(len(columns)))]
        return _set(table, name, columns[kind]), f"column {name}: {kind}"

    return _rewritten(path, change)


@mutation("parquet")
def _value(path: Path, random: Random) -> str:
    def change(table: pa.Table) -> tuple[pa.Table, str]:
        name, row = _column(table, random), int(random.integers(table.num_rows))
        values, value = table[name].to_pylist(), _NUMBERS[int(random.integers(len(_NUMBERS)))]
        kind = table[name].type
        if random.random() < 0.3:
            values[row], value = None, np.nan
        elif isinstance(values[row], list) and values[row]:
            values[row][int(random.integers(len(values[row])))] = value
        elif isinstance(values[row], str):
            values[row] = str(value)
        else:
            values[row] = value
        whole = pa.types.is_integer(kind) or pa.types.is_boolean(kind)
        return _set(table, name, pa.array(values, pa.float64() if whole else None)), f"{name}, row {row}: {value}"

    try:
        return _rewritten(path, change)
    except (pa.ArrowException, TypeError):
        return _column_of_another_kind(path, random)


@mutation("parquet")
def _without_column(path: Path, random: Random) -> str:
    def change(table: pa.Table) -> tuple[pa.Table, str]:
        name = _column(table, random)
        return table.drop_columns([name]), f"without column {name}"

    return _rewritten(path, change)


@mutation("parquet", outcome=SAME)
def _unknown_column(path: Path, random: Random) -> str:
    return _rewritten(path, lambda table: (table.append_column("unknown", pa.nulls(table.num_rows)), "another column"))


@mutation("parquet")
def _rows(path: Path, random: Random) -> str:
    def change(table: pa.Table) -> tuple[pa.Table, str]:
        count, row = table.num_rows, int(random.integers(table.num_rows))
        index = {
            "twice": [*range(count), row],
            "missing": [k for k in range(count) if k != row],
            "alone": [row],
            "and all after it missing": list(range(row)),
        }
        how = list(index)[int(random.integers(len(index)))]
        return table.take(pa.array(index[how], pa.int64())), f"row {row} {how}"

    return _rewritten(path, change)


@mutation("parquet")
def _named_twice(path: Path, random: Random) -> str:
    def change(table: pa.Table) -> tuple[pa.Table, str]:
        name = _column(table, random)
        return table.append_column(name, table[name]), f"column {name} twice"

    return _rewritten(path, change)


@mutation("parquet")
def _metadata(path: Path, random: Random) -> str:
    def change(table: pa.Table) -> tuple[pa.Table, str]:
        notes = {b"clothkit": b"[", b"pandas": b"{}"}
        return table.replace_schema_metadata(notes), "damaged metadata"

    return _rewritten(path, change)


# Stores.


def _member(store: Path, pattern: str, random: Random) -> Path | None:
    found = sorted(path for path in store.rglob(pattern) if path.is_file())
    return found[int(random.integers(len(found)))] if found else None


@mutation("zarr", outcome=REFUSED)
def _array_missing(path: Path, random: Random) -> str:
    metadata = _member(path, "*/zarr.json", random)
    if metadata is None:
        return missing(path, random)
    shutil.rmtree(metadata.parent)
    return f"array {metadata.parent.name} missing"


@mutation("zarr", outcome=REFUSED)
def _group_instead(path: Path, random: Random) -> str:
    metadata = _member(path, "*/zarr.json", random) or path / "zarr.json"
    metadata.write_text('{"zarr_format": 3, "node_type": "group", "attributes": {}}')
    return f"{metadata.parent.name} made a group"


@mutation("zarr", outcome=REFUSED)
def _shape_of_a_billion(path: Path, random: Random) -> str:
    metadata = _member(path, "*/zarr.json", random) or path / "zarr.json"
    stored = json.loads(metadata.read_text())
    stored["shape"] = [10**9, *stored["shape"][1:]]
    metadata.write_text(json.dumps(stored))
    return f"{metadata.parent.name} said to be 10^9 long"


def _chunk(store: Path, random: Random) -> Path | None:
    chunks = sorted(path for path in store.rglob("*") if path.is_file() and path.name != "zarr.json")
    return chunks[int(random.integers(len(chunks)))] if chunks else None


@mutation("zarr", outcome=REFUSED)
def _chunk_missing(path: Path, random: Random) -> str | None:
    chunk = _chunk(path, random)
    if chunk is None:
        return None
    chunk.unlink()
    return f"{chunk.relative_to(path)} missing"


@mutation("zarr", outcome=REFUSED)
def _chunk_cut(path: Path, random: Random) -> str | None:
    chunk = _chunk(path, random)
    return None if chunk is None else f"{chunk.relative_to(path)}: {truncated(chunk, random)}"


@mutation("zarr")
def _file_damaged(path: Path, random: Random) -> str | None:
    file = _member(path, "*", random)
    if file is None:
        return None
    own = [known for known in (*KINDS["bytes"], *KINDS["system"]) if known.outcome != SAME]
    return f"{file.relative_to(path)}: {own[int(random.integers(len(own)))].apply(file, random)}"


@mutation("zarr")
def _metadata_changed(path: Path, random: Random) -> str | None:
    metadata = _member(path, "zarr.json", random)
    if metadata is None:
        return None
    own = [known for known in KINDS["json"] if known.outcome != SAME]
    return f"{metadata.relative_to(path)}: {own[int(random.integers(len(own)))].apply(metadata, random)}"


@mutation("zarr")
def _chunk_of_another(path: Path, random: Random) -> str | None:
    one, other = _chunk(path, random), _chunk(path, random)
    if one is None or other is None or one == other:
        return None
    shutil.copyfile(other, one)
    return f"{other.relative_to(path)} in place of {one.relative_to(path)}"


@mutation("zarr", outcome=SAME)
def _strange_file(path: Path, random: Random) -> str:
    (path / "unknown").write_bytes(random.bytes(20))
    return "a strange file in it"
