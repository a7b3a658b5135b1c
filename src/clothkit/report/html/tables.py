"""Tables as HTML, with our figure above the paper's in each cell and the better one marked."""

import math
from collections.abc import Collection, Mapping, Sequence
from itertools import groupby

import pandas as pd

from clothkit.report import captions
from clothkit.report.budgets import DAGGER
from clothkit.report.formatting import JUDGED, SOURCES, TOO_FEW, better, number
from clothkit.report.html.elements import Html, element, joined
from clothkit.report.layout import HIGH, LOW, NO_ACTION

STATISTICS = {"std": "st.dev.", LOW: "95 % of mean"}


def paired(
    data: pd.DataFrame,
    keys: Sequence[str],
    *,
    label: str,
    heads: Mapping[str, str] | None = None,
    unit: str = "",
    judged: Collection[str] = JUDGED,
    ideal: float = -math.inf,
) -> Html:
    """A table with the paper's figures below ours. `keys` are the one or two columns that identify a row.

    With two keys, rows are grouped under a heading for each value of the first. All columns but `keys` and source
    (clothkit, paper) hold figures; `heads` gives their headings. In rows whose last key is in `judged`, the better of
    the two figures is marked, see `printed.better`.
    """
    columns = [column for column in data.columns if column not in (*keys, "source")]
    found: dict[tuple[str, ...], dict[str, dict]] = {}
    for row in data.to_dict("records"):
        found.setdefault(tuple(str(row[key]) for key in keys), {})[str(row["source"])] = dict(row)
    # All rows of a system are adjacent, including those that only the paper has.
    places = list(dict.fromkeys(key[0] for key in found))
    ordered = sorted(found, key=lambda key: places.index(key[0]))
    bodies = []
    for system, own_keys in groupby(ordered, key=lambda key: key[0] if len(keys) > 1 else ""):
        lines = [_system(system, len(columns))] if len(keys) > 1 else []
        for key in own_keys:
            if key[-1] != HIGH:
                high = found.get((*key[:-1], HIGH)) if key[-1] == LOW else None
                lines.append(_line(key[-1], found[key], columns, high, ideal if key[-1] in judged else None))
        bodies.append(element("tbody", *lines))
    order = f"{unit}; clothkit above, the paper below; " if unit else "clothkit above, the paper below; "
    caption = element("caption", order, _mark(), " the better")
    head = _two_heads(columns) if any("/" in column for column in columns) else _head(columns, heads or {})
    return _scrolling(element("table", caption, head, *bodies, class_="paired"), label)


def plain(data: pd.DataFrame, *, label: str) -> Html:
    """A table with its columns and rows unchanged; cells of the first column are row headings."""
    words = [bool(data[column].map(_is_word).any()) for column in data.columns]
    heads = [
        element("th", column.replace("_", " "), scope="col", class_="word" if word else None)
        for column, word in zip(data.columns, words, strict=True)
    ]
    lines = []
    for first, *rest in data.itertuples(index=False):
        cells = [element("td", _text(value), class_="word" if _is_word(value) else None) for value in rest]
        lines.append(element("tr", element("th", _text(first), scope="row"), *cells))
    parts = (element("thead", element("tr", *heads)), element("tbody", *lines))
    return _scrolling(element("table", *parts, class_="plain"), label)


def named(name: str) -> Html:
    """The name of a system or kind, followed by its meaning if it is known."""
    words = captions.SYSTEMS.get(name.removesuffix(DAGGER))
    return joined(element("b", name), " ", element("span", words, class_="words")) if words else element("b", name)


def _scrolling(table: Html, label: str) -> Html:
    # tabindex makes the element focusable, so that it can be scrolled by keyboard.
    return element("div", table, class_="scroll", tabindex=0, role="region", aria_label=label)


def _mark() -> Html:
    return element("b", "●", class_="mark", aria_hidden="true")


def _system(name: str, columns: int) -> Html:
    return element(
        "tr", element("th", element("span", named(name)), scope="rowgroup", colspan=columns + 1), class_="of"
    )


def _line(
    name: str, sources: dict[str, dict], columns: Sequence[str], high: dict[str, dict] | None, ideal: float | None
) -> Html:
    """A row of a table. Without `ideal` no figure is marked; with `high` the cells are intervals of our means."""
    cells = []
    for column in columns:
        own, paper = (float(sources.get(source, {}).get(column, math.nan)) for source in SOURCES)
        if high is not None:
            # The ends are in two lines, so that the column is no wider than other rows need.
            ends = (TOO_FEW,) if math.isnan(own) else (f"{number(own)} to", number(float(high["clothkit"][column])))
            cells.append(element("td", *(element("span", end, class_="own") for end in ends)))
            continue
        best = None if ideal is None else better(own, paper, ideal=ideal)
        lines = [_figure(own, "own", best == "clothkit")] if "clothkit" in sources else []
        lines += [_figure(paper, "paper", best == "paper")] if "paper" in sources else []
        cells.append(element("td", *lines))
    strong = ideal is not None and name != "median" and not name.startswith(NO_ACTION)
    return element(
        "tr", element("th", STATISTICS.get(name, name), scope="row"), *cells, class_="mean" if strong else None
    )


def _figure(value: float, source: str, marked: bool) -> Html:
    # For screen readers, since colour and place tell it to the eye alone.
    source_name = element("span", "clothkit: " if source == "own" else "paper: ", class_="visually-hidden")
    verdict = element("span", " (better)", class_="visually-hidden") if marked else ""
    return element(
        "span",
        source_name,
        *([_mark()] if marked else []),
        number(value),
        verdict,
        class_=f"{source} better" if marked else source,
    )


def _head(columns: Sequence[str], heads: Mapping[str, str]) -> Html:
    cells = [element("th", heads.get(column, column), scope="col") for column in columns]
    return element("thead", element("tr", element("td"), *cells))


def _two_heads(columns: Sequence[str]) -> Html:
    """Two rows of headings for columns named length / start: lengths above, starts below."""
    lengths = [(length, list(of_length)) for length, of_length in groupby(columns, key=lambda column: column[0])]
    upper = [
        element("th", f"{length} manipulation{'s' * (length != '1')}", scope="colgroup", colspan=len(of_length))
        for length, of_length in lengths
    ]
    starts = [column.partition("/")[2] for column in columns]
    lower = [element("th", start if start == "all" else f"from {start}", scope="col") for start in starts]
    return element("thead", element("tr", element("td"), *upper), element("tr", element("td"), *lower))


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is pd.NA:
        return number(math.nan)
    return number(value) if isinstance(value, float) else str(value)


def _is_word(value: object) -> bool:
    return isinstance(value, str) and value != TOO_FEW
