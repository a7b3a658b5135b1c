"""The paper's own figures, from `published/table_<number>.csv`, in the layout of our tables."""

from collections.abc import Collection
from pathlib import Path

import pandas as pd

FOLDER = Path(__file__).with_name("published")


def table(number: int) -> pd.DataFrame:
    """A table of the paper: source, split, kind or system, statistic, then its columns [cloth length]."""
    return pd.read_csv(FOLDER / f"table_{number}.csv")


def table_of(number: int, systems: Collection[str]) -> pd.DataFrame:
    """The rows of a table of the paper that are about the given systems."""
    rows = table(number)
    return rows[rows["system"].isin(list(systems))].reset_index(drop=True)


def sigma_ratios() -> pd.DataFrame:
    """The paper's median sigma ratios on the test set (sections 6.1 and 6.2); 0.798 is ideal."""
    return pd.read_csv(FOLDER / "sigma_ratio.csv")


def without_paper(table: pd.DataFrame) -> pd.DataFrame:
    """A table of a report without the paper's rows, if it has any."""
    return table[table["source"] != "paper"].reset_index(drop=True) if "source" in table else table
