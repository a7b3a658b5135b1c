"""Tables as Markdown: the paper's figures beside ours, three significant digits, the means in bold."""

from collections.abc import Sequence

import pandas as pd

_SOURCES = ["clothkit", "paper"]


def table(data: pd.DataFrame, keys: Sequence[str]) -> str:
    """A table as a Markdown string: `keys` first, then the source, then its columns; rows of equal keys together.

    The order is that of our rows; rows that only the paper has come last.
    """
    columns = [column for column in data.columns if column not in (*keys, "source")]
    lines = [_line([*keys, "source", *columns]), _line(["---"] * (len(keys) + 1) + ["---:"] * len(columns))]
    together: dict[tuple, list[dict]] = {}
    for row in data.to_dict("records"):
        together.setdefault(tuple(row[key] for key in keys), []).append(row)
    for key, rows in together.items():
        for row in sorted(rows, key=lambda row: _SOURCES.index(row["source"])):
            strong = "**" if row["source"] == "clothkit" and "mean" in key else ""
            figures = [_strong(row[column], strong) for column in columns]
            lines.append(_line([*map(str, key), row["source"], *figures]))
    return "\n".join(lines) + "\n"


def plain(data: pd.DataFrame) -> str:
    """A table as a Markdown string, column by column and row by row as it stands."""
    head = [_line(list(data.columns)), _line(["---"] * len(data.columns))]
    return "\n".join(head + [_line([_cell(value) for value in row]) for row in data.itertuples(index=False)]) + "\n"


def _cell(value: object) -> str:
    return number(value) if isinstance(value, float) else str(value).replace("|", "\\|")


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _strong(value: float, strong: str) -> str:
    return number(value) if pd.isna(value) else f"{strong}{number(value)}{strong}"


def number(value: float) -> str:
    """Three significant digits, as the paper has them; a dash for what was not measured."""
    return "–" if pd.isna(value) else f"{value:#.3g}".rstrip(".")
