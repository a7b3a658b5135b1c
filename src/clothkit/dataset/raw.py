"""Reading the raw artifacts: what the simulation wrote, before it is a grid of 32 x 32 (design section 4)."""

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from clothkit.errors import InputError

STATE_COLUMNS = ("sequence", "state", "topology", "vertices")
MANIPULATION_COLUMNS = ("sequence", "step", "hands", "u1", "v1", "u2", "v2", "dx", "dy")
TOPOLOGY_COLUMNS = ("topology", "material", "triangles")


def read_table(path: Path, columns: tuple[str, ...]) -> pd.DataFrame:
    """The named columns of a parquet file. Raises InputError naming a file or column that can't be read."""
    try:
        found = pq.read_schema(path).names
        missing = [column for column in columns if column not in found]
        if missing:
            raise InputError(f"{path}: has no column {missing[0]!r}")
        return pq.read_table(path, columns=list(columns)).to_pandas()
    except FileNotFoundError as error:
        raise InputError(f"{path}: not found; run the stage that writes it (dvc repro)") from error
    except (pa.ArrowInvalid, OSError) as error:
        raise InputError(f"{path}: can't be read as parquet ({str(error).splitlines()[0]})") from error


def read_states(folder: Path) -> pd.DataFrame:
    """Every state, by sequence and state. Raises InputError when one is missing, has no vertices or isn't finite."""
    files = sorted(folder.glob("*.parquet"))
    if not files:
        raise InputError(f"{folder}: holds no parquet file of states")
    tables = []
    for file in files:
        table = read_table(file, STATE_COLUMNS)
        for sequence, state, vertices in zip(table["sequence"], table["state"], table["vertices"], strict=True):
            if len(vertices) % 3:
                raise InputError(f"{file}: vertices of sequence {sequence}, state {state} are not x y z triples")
            if not np.isfinite(vertices).all():
                raise InputError(f"{file}: vertices of sequence {sequence}, state {state} are not finite")
        tables.append(table)
    return pd.concat(tables).sort_values(["sequence", "state"], kind="stable").reset_index(drop=True)
