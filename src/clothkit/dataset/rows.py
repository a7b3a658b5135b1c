"""Writes tidy rows to parquet, with stage, scale and params in the file's metadata (design section 4)."""

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq


def write_rows(path: Path, rows: pd.DataFrame, attributes: dict[str, Any]) -> None:
    """Write rows as parquet, with the attributes as JSON under the metadata key `clothkit`.

    Equal rows and attributes give equal bytes.
    """
    table = pa.Table.from_pandas(rows, preserve_index=False)
    metadata = {**(table.schema.metadata or {}), b"clothkit": json.dumps(attributes, sort_keys=True).encode()}
    pq.write_table(table.replace_schema_metadata(metadata), path)
