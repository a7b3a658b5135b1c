"""Output of benchmarks: tables as aligned text, and as CSV files if asked for."""

from pathlib import Path

import pandas as pd


def show(title: str, rows: list[dict], *, csv: Path | None = None) -> None:
    """Print rows as a table under a title; with a folder, also write the file of `write`."""
    table = pd.DataFrame(rows)
    print(f"\n{title}\n{table.to_string(index=False, na_rep='')}", flush=True)
    write(title, rows, csv)


def write(title: str, rows: list[dict], csv: Path | None) -> None:
    """Write the rows that there are as a CSV file named after the title's first words; without a folder, nothing.

    Called after each row, so that a benchmark that is stopped leaves those that it had.
    """
    if csv:
        csv.mkdir(parents=True, exist_ok=True)
        name = "_".join(title.lower().split(":")[0].split(",")[0].split())
        pd.DataFrame(rows).to_csv(csv / f"{name}.csv", index=False)
