"""Writer of the raw artifacts: sequences as parquet files (design section 4). Equal records give equal bytes.

Both sources of sequences, our solver and ARCSim's runs, use the schemas declared here.
"""

import itertools
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from clothkit.cloth.topology import Shape, triangles
from clothkit.simulation.attempts import Attempts
from clothkit.simulation.settings import DRAWN
from clothkit.simulation.solver import flat_grid

SHARD = 500  # sequences in a file of states
TOGETHER = 1024  # rectangles in a row group of topologies: far from the 2^31 values that a list column holds
QUALITY = ("height", "strain_p99", "strain_worst", "intersections", "gap", "residual_speed")
"""Columns measured on every state, accepted or not."""

STATES = pa.schema(
    {
        "sequence": pa.int32(),
        "state": pa.int32(),
        "topology": pa.int32(),
        "vertices": pa.list_(pa.float32()),
        "height": pa.float32(),
        "strain_p99": pa.float32(),
        "strain_worst": pa.float32(),
        "intersections": pa.int32(),
        "gap": pa.float32(),
        "residual_speed": pa.float32(),
    }
)
MANIPULATIONS = pa.schema(
    {
        "sequence": pa.int32(),
        "step": pa.int32(),
        "hands": pa.int32(),
        **{name: pa.float32() for name in ("u1", "v1", "u2", "v2", "dx", "dy")},
        **{name: pa.float32() for name in ("release_x1", "release_y1", "release_x2", "release_y2")},
        "seed": pa.int64(),
        "attempt": pa.int64(),
        "settle_time": pa.float32(),
    }
)
ATTEMPTS = pa.schema(
    {
        "attempt": pa.int64(),
        "seed": pa.int64(),
        "accepted": pa.bool_(),
        "reason": pa.string(),
        "states": pa.int32(),
        "area": pa.list_(pa.float32()),
        "folds": pa.list_(pa.int32()),
        **{name: pa.list_(pa.float32()) for name in (*QUALITY, "settle_time")},
    }
)
TOPOLOGIES = pa.schema({"topology": pa.int32(), "material": pa.list_(pa.float32()), "triangles": pa.list_(pa.int32())})
CLOTHS = pa.schema(
    {
        "sequence": pa.int32(),
        "start": pa.string(),
        **{name: pa.float32() for name in ("side_u", "side_v", *DRAWN)},
    }
)
GOAL = pa.field("goal", pa.string())
"""A further column of cloths if sequences begin with folds of named goals: whose, or null."""

SCHEMAS = {
    "states": STATES,
    "manipulations": MANIPULATIONS,
    "attempts": ATTEMPTS,
    "topologies": TOPOLOGIES,
    "cloths": CLOTHS,
}


def write_raw(
    folder: Path,
    attempts: Attempts,
    states: Iterable[np.ndarray],
    *,
    seed: int,
    attributes: dict[str, Any],
) -> None:
    """Write our solver's states, manipulations, attempts, topologies and cloths under `folder`.

    The field `states` of the attempts is not used. The argument `states` yields the states of the accepted attempts in
    order, in pieces of any size [accepted states u v 3]; surplus pieces at the end are ignored.
    """
    accepted = Attempts(*(array[attempts.accepted] for array in attempts))
    sides, topology = np.unique(accepted.sides, axis=0, return_inverse=True)
    shards = (
        _states(Attempts(*(array[first : first + SHARD] for array in accepted))._replace(states=part), first, topology)
        for first, part in _shards(states, len(accepted.attempt))
    )
    others = {
        "manipulations": _manipulations(accepted, seed),
        "attempts": _attempts(attempts, seed),
        "topologies": _topologies(sides, attempts.states.shape[2:4]),
        "cloths": _cloths(accepted),
    }
    write_tables(folder, shards, others, attributes)


def _shards(pieces: Iterable[np.ndarray], count: int) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the first `count` rows of the pieces in arrays of up to SHARD rows, each with its first row's number."""
    rows: list[np.ndarray] = []
    first = 0
    for row in itertools.islice((row for piece in pieces for row in piece), count):
        rows.append(row)
        if len(rows) == min(SHARD, count - first):
            yield first, np.stack(rows)
            first, rows = first + len(rows), []


def write_tables(
    folder: Path,
    states: Iterable[pa.Table],
    others: Mapping[str, pa.Table | Iterable[pa.Table]],
    attributes: dict[str, Any],
) -> None:
    """Write `states/0000.parquet` ... and one file per other table; `attributes` go into each file's metadata.

    A table may come in parts, each of which becomes a row group of its file.
    """
    metadata = {"clothkit": json.dumps(attributes, sort_keys=True)}
    (folder / "states").mkdir(parents=True, exist_ok=True)
    for number, shard in enumerate(states):
        _write(folder / "states" / f"{number:04d}.parquet", [shard], metadata)
    for name, table in others.items():
        parts = [table] if isinstance(table, pa.Table) else table
        _write(folder / f"{name}.parquet", parts, metadata)


def _write(path: Path, parts: Iterable[pa.Table], metadata: dict[str, str]) -> None:
    tables = (part.replace_schema_metadata(metadata) for part in parts)
    first = next(tables)
    with pq.ParquetWriter(path, first.schema, compression="zstd") as writer:
        for table in itertools.chain([first], tables):
            writer.write_table(table)


def _states(part: Attempts, first: int, topology: np.ndarray) -> pa.Table:
    count, states = part.states.shape[:2]
    sequence, state = np.divmod(np.arange(count * states), states)
    columns: dict[str, Any] = {
        "sequence": sequence.astype(np.int32) + first,
        "state": state.astype(np.int32),
        "topology": np.repeat(topology[first : first + count].astype(np.int32), states),
        "vertices": _lists(part.states.reshape(count * states, -1)),
    }
    columns |= {name: getattr(part, name).ravel() for name in QUALITY}
    return pa.table(columns, schema=STATES)


def _manipulations(accepted: Attempts, seed: int) -> pa.Table:
    count, steps = accepted.hands.shape
    sequence, step = np.divmod(np.arange(count * steps), steps)
    columns: dict[str, Any] = {
        "sequence": sequence.astype(np.int32),
        "step": step.astype(np.int32),
        "hands": accepted.hands.ravel(),
    }
    vectors = accepted.manipulation.reshape(-1, 6)
    columns |= {name: vectors[:, k] for k, name in enumerate(("u1", "v1", "u2", "v2", "dx", "dy"))}
    releases = accepted.releases.reshape(-1, 4)
    columns |= {name: releases[:, k] for k, name in enumerate(("release_x1", "release_y1", "release_x2", "release_y2"))}
    columns["seed"] = np.full(count * steps, seed, np.int64)
    columns["attempt"] = np.repeat(accepted.attempt, steps)
    columns["settle_time"] = accepted.settle_time.ravel()
    return pa.table(columns, schema=MANIPULATIONS)


def _attempts(attempts: Attempts, seed: int) -> pa.Table:
    columns: dict[str, Any] = {
        "attempt": attempts.attempt,
        "seed": np.full(len(attempts.attempt), seed, np.int64),
        "accepted": attempts.accepted,
        "reason": attempts.reason.tolist(),
        "states": attempts.reached,
        "area": _lists(attempts.area),
        "folds": _lists(attempts.folds),
    }
    # Rejected states are written, too, so that the effect of the limits on the data can be analysed.
    columns |= {name: _lists(_reached(getattr(attempts, name), attempts.reached)) for name in QUALITY}
    columns["settle_time"] = _lists(_reached(attempts.settle_time, attempts.reached - 1))
    return pa.table(columns, schema=ATTEMPTS)


def _reached(values: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return the values as float32, a row per attempt, with NaN after the first `count` values of each row."""
    return np.where(np.arange(values.shape[1]) < count[:, None], values, np.nan).astype(np.float32)


def _topologies(sides: np.ndarray, shape: Shape) -> Iterator[pa.Table]:
    """Yield a row per pair of sides, in metres: grids of `shape` vertices, TOGETHER of them in a table."""
    for first in range(0, len(sides), TOGETHER):
        part = sides[first : first + TOGETHER]
        material = [flat_grid(shape, (along_u, along_v)).ravel() for along_u, along_v in part]
        columns = {
            "topology": np.arange(first, first + len(part), dtype=np.int32),
            "material": _lists(np.stack(material)),
            "triangles": _lists(np.tile(triangles(shape).ravel(), (len(part), 1))),
        }
        yield pa.table(columns, schema=TOPOLOGIES)


def _cloths(accepted: Attempts) -> pa.Table:
    columns: dict[str, Any] = {
        "sequence": np.arange(len(accepted.attempt), dtype=np.int32),
        "start": accepted.start.tolist(),
        "side_u": accepted.sides[:, 0],
        "side_v": accepted.sides[:, 1],
    }
    columns |= {name: accepted.material[:, k] for k, name in enumerate(DRAWN)}
    if not accepted.goal.any():
        return pa.table(columns, schema=CLOTHS)
    columns["goal"] = [goal or None for goal in accepted.goal.tolist()]
    return pa.table(columns, schema=CLOTHS.append(GOAL))


def _lists(rows: np.ndarray) -> pa.Array:
    """Return an array of lists, one per row."""
    offsets = np.arange(len(rows) + 1, dtype=np.int32) * rows.shape[1]
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(rows.ravel()))
