"""Tables as Markdown: the paper's figures beside ours, three significant digits, the better of two in bold."""

import math
from collections.abc import Collection, Sequence

import pandas as pd

from clothkit.report.formatting import JUDGED, SOURCES, better, number, statistic


def paired(
    data: pd.DataFrame, keys: Sequence[str], *, judged: Collection[str] = JUDGED, ideal: float = -math.inf
) -> str:
    """A table as a Markdown string: `keys` first, then the source, then its columns; rows of equal keys together.

    In rows whose last key is in `judged`, the better of our figure and the paper's is bold, see `printed.better`. Rows
    keep the order of the data.
    """
    columns = [column for column in data.columns if column not in (*keys, "source")]
    lines = [_line([*keys, "source", *columns]), _line(["---"] * (len(keys) + 1) + ["---:"] * len(columns))]
    together: dict[tuple, dict[str, dict]] = {}
    for row in data.to_dict("records"):
        together.setdefault(tuple(row[key] for key in keys), {})[row["source"]] = row
    for key, found in together.items():
        best = {column: _best(found, column, ideal) for column in columns} if key[-1] in judged else {}
        for source in SOURCES:
            if source in found:
                shown = [statistic(key[-1], found[source][column]) for column in columns]
                figures = [
                    f"**{figure}**" if best.get(column) == source else figure
                    for figure, column in zip(shown, columns, strict=True)
                ]
                lines.append(_line([*map(_escaped, key), source, *figures]))
    return "\n".join(lines) + "\n"


def plain(data: pd.DataFrame) -> str:
    """A table as a Markdown string, with its columns and rows unchanged."""
    head = [_line(list(data.columns)), _line(["---"] * len(data.columns))]
    return "\n".join(head + [_line([_cell(value) for value in row]) for row in data.itertuples(index=False)]) + "\n"


def _best(found: dict[str, dict], column: str, ideal: float) -> str | None:
    own, paper = (float(found.get(source, {}).get(column, math.nan)) for source in SOURCES)
    return better(own, paper, ideal=ideal)


def _cell(value: object) -> str:
    if value is pd.NA:
        return number(math.nan)
    return number(value) if isinstance(value, float) else _escaped(value)


def _escaped(value: object) -> str:
    return str(value).replace("|", "\\|")


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
