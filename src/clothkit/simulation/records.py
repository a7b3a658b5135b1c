"""The raw artifacts: sequences as parquet files (design section 4). Equal records give equal bytes."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from clothkit.cloth.grid import triangles
from clothkit.simulation.attempts import Attempts
from clothkit.simulation.settings import SimulationConfig
from clothkit.simulation.solver import flat_state

SHARD = 500  # sequences in a file of states
QUALITY = ("height", "strain_p99", "strain_worst", "intersections", "gap", "residual_speed")
"""What is measured on every state, accepted or not."""


def write_raw(
    folder: Path, attempts: Attempts, simulation: SimulationConfig, *, seed: int, attributes: dict[str, Any]
) -> None:
    """Write states, manipulations, attempts and topologies; `attributes` go into each file's metadata."""
    metadata = {"clothkit": json.dumps(attributes, sort_keys=True)}
    accepted = Attempts(*(array[attempts.accepted] for array in attempts))
    (folder / "states").mkdir(parents=True, exist_ok=True)
    for shard, first in enumerate(range(0, len(accepted.attempt), SHARD)):
        part = Attempts(*(array[first : first + SHARD] for array in accepted))
        _write(folder / "states" / f"{shard:04d}.parquet", _states(part, first), metadata)
    _write(folder / "manipulations.parquet", _manipulations(accepted, seed), metadata)
    _write(folder / "attempts.parquet", _attempts(attempts, seed), metadata)
    _write(folder / "topologies.parquet", _topologies(simulation), metadata)


def _write(path: Path, columns: dict[str, Any], metadata: dict[str, str]) -> None:
    table = pa.table(columns).replace_schema_metadata(metadata)
    pq.write_table(table, path, compression="zstd")


def _states(part: Attempts, first: int) -> dict[str, Any]:
    count, states = part.states.shape[:2]
    sequence, state = np.divmod(np.arange(count * states), states)
    columns: dict[str, Any] = {
        "sequence": sequence.astype(np.int32) + first,
        "state": state.astype(np.int32),
        "topology": np.zeros(count * states, np.int32),
        "vertices": _lists(part.states.reshape(count * states, -1)),
    }
    return columns | {name: getattr(part, name).ravel() for name in QUALITY}


def _manipulations(accepted: Attempts, seed: int) -> dict[str, Any]:
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
    return columns


def _attempts(attempts: Attempts, seed: int) -> dict[str, Any]:
    columns: dict[str, Any] = {
        "attempt": attempts.attempt,
        "seed": np.full(len(attempts.attempt), seed, np.int64),
        "accepted": attempts.accepted,
        "reason": attempts.reason.tolist(),
        "states": attempts.reached,
        "area": _lists(attempts.area),
        "folds": _lists(attempts.folds),
    }
    # Tried states are written beside the accepted ones: what the limits do to the data can then be seen.
    columns |= {name: _lists(_reached(getattr(attempts, name), attempts.reached)) for name in QUALITY}
    return columns | {"settle_time": _lists(_reached(attempts.settle_time, attempts.reached - 1))}


def _reached(values: np.ndarray, count: np.ndarray) -> np.ndarray:
    """A row per attempt as float32, NaN after its first `count` values."""
    return np.where(np.arange(values.shape[1]) < count[:, None], values, np.nan).astype(np.float32)


def _topologies(simulation: SimulationConfig) -> dict[str, Any]:
    material = flat_state(simulation)[..., :2].reshape(1, -1)
    return {
        "topology": np.zeros(1, np.int32),
        "material": _lists(material),
        "triangles": _lists(triangles(simulation.side).reshape(1, -1)),
    }


def _lists(rows: np.ndarray) -> pa.Array:
    """A row per list."""
    offsets = np.arange(len(rows) + 1, dtype=np.int32) * rows.shape[1]
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(rows.ravel()))
