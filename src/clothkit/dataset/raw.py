"""Reading the raw artifacts: what the simulation wrote, before it is a grid of 32 x 32 (design section 4)."""

import json
from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float, Int

from clothkit.errors import InputError

STATE_COLUMNS = ("sequence", "state", "topology", "vertices")
MANIPULATION_COLUMNS = ("sequence", "step", "hands", "u1", "v1", "u2", "v2", "dx", "dy")
TOPOLOGY_COLUMNS = ("topology", "material", "triangles")


def read_table(
    path: Path,
    columns: tuple[str, ...],
    *,
    optional: tuple[str, ...] = (),
    sequences: Collection[int] | None = None,
) -> pd.DataFrame:
    """The named columns of a parquet file, of all or of the given sequences; `optional` ones where there are any.

    Raises InputError naming a file or column that can't be read.
    """
    try:
        found = pq.read_schema(path).names
        missing = [column for column in columns if column not in found]
        if missing:
            raise InputError(f"{path}: has no column {missing[0]!r}")
        wanted = [*columns, *(column for column in optional if column in found)]
        rows = None if sequences is None else [("sequence", "in", sorted(sequences))]
        return pq.read_table(path, columns=wanted, filters=rows).to_pandas()
    except FileNotFoundError as error:
        raise InputError(f"{path}: not found; run the stage that writes it (dvc repro)") from error
    except (pa.ArrowInvalid, OSError) as error:
        raise InputError(f"{path}: can't be read as parquet ({str(error).splitlines()[0]})") from error


def read_attributes(path: Path) -> dict[str, Any]:
    """What a parquet file says of how it was made: stage, scale and params; empty when it says nothing."""
    try:
        return json.loads((pq.read_schema(path).metadata or {}).get(b"clothkit", b"{}"))
    except FileNotFoundError as error:
        raise InputError(f"{path}: not found; run the stage that writes it (dvc repro)") from error
    except (pa.ArrowInvalid, OSError, ValueError) as error:
        raise InputError(f"{path}: its attributes can't be read ({str(error).splitlines()[0]})") from error


def state_files(folder: Path) -> list[Path]:
    """The parquet files that states are spread over. Raises InputError when there are none."""
    files = sorted(folder.glob("*.parquet"))
    if not files:
        raise InputError(f"{folder}: holds no parquet file of states")
    return files


def read_states(folder: Path, *, sequences: Collection[int] | None = None) -> pd.DataFrame:
    """Every state, or those of some sequences, by sequence and state.

    Raises InputError when one has no vertices or isn't finite.
    """
    tables = []
    for file in state_files(folder):
        table = read_table(file, STATE_COLUMNS, sequences=sequences)
        for sequence, state, vertices in zip(table["sequence"], table["state"], table["vertices"], strict=True):
            if len(vertices) % 3:
                raise InputError(f"{file}: vertices of sequence {sequence}, state {state} are not x y z triples")
            if not np.isfinite(vertices).all():
                raise InputError(f"{file}: vertices of sequence {sequence}, state {state} are not finite")
        tables.append(table)
    return pd.concat(tables).sort_values(["sequence", "state"], kind="stable").reset_index(drop=True)


class Topology(NamedTuple):
    """What states of one triangulation share."""

    material: Float[np.ndarray, "vertices 2"]
    """Where each vertex lies on the flat cloth [m]."""
    triangles: Int[np.ndarray, "triangles 3"]


class Topologies:
    """The triangulations of a folder of raw artifacts."""

    def __init__(self, raw: Path) -> None:
        self.rows = read_table(raw / "topologies.parquet", TOPOLOGY_COLUMNS).set_index("topology")
        self.path = raw / "topologies.parquet"

    def __call__(self, where: str, number: int, vertices: np.ndarray) -> tuple[Topology, np.ndarray]:
        """A state's topology, and its vertices as float32 [vertices 3].

        Raises InputError, naming the state as `where` says, when there is no such topology or its vertices are others.
        """
        if number not in self.rows.index:
            raise InputError(f"{where}: its topology {number} is not in topologies.parquet")
        material = np.asarray(self.rows.at[number, "material"], float).reshape(-1, 2)
        triangles = np.asarray(self.rows.at[number, "triangles"], np.int32).reshape(-1, 3)
        positions = np.asarray(vertices, np.float32).reshape(-1, 3)
        if len(positions) != len(material):
            raise InputError(f"{where}: has {len(positions)} vertices, its topology {number} has {len(material)}")
        return Topology(material, triangles), positions
