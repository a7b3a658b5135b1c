"""The four most important figures in large print, each with the paper's figure and a sentence on its meaning."""

import math

import pandas as pd

from clothkit.report.contents import Contents
from clothkit.report.html.elements import Html, element
from clothkit.report.layout import LABELLED
from clothkit.report.printed import better, number

FIGURES = (
    ("Seeing", "table_2", "kind", "dmr", "all", "how far a mesh estimated from voxels is from the true one"),
    ("Foreseeing", "table_3", "system", "main", "3/all", "how far the state foreseen after three manipulations is off"),
    ("Folding in one", "table_6", "system", "main", "1/all", "how far from its goal a one-step plan leaves the cloth"),
    ("Folding in three", "table_6", "system", "main", "3/all", "how far from its goal a three-step plan leaves it"),
)
"""Title, table, the column that identifies its rows, the row, the figure's column, and the figure's meaning."""


def headline(contents: Contents) -> Html:
    """A card for each of FIGURES whose table exists: means on the test set [cloth length]."""
    shown = [figure for figure in FIGURES if figure[1] in contents.tables]
    return element("div", *(_card(contents.tables[figure[1]], *figure) for figure in shown), class_="cards")


def _card(rows: pd.DataFrame, title: str, table: str, by: str, name: str, column: str, meaning: str) -> Html:
    rows = rows[rows["split"] == "test"]
    means = rows[rows["statistic"] == "mean"]
    own, paper, none = (
        _figure(means, "clothkit", by, name, column),
        _figure(means, "paper", by, name, column),
        _figure(means, "clothkit", by, "no action", column),
    )
    best = better(own, paper)
    if best == "clothkit":
        held = "better than the paper's, in another simulator:"
    elif best == "paper":
        held = "the paper's, in another simulator, is better:"
    else:
        held = "the paper's, in another simulator:"
    text = f"{meaning[0].upper()}{meaning[1:]}; doing nothing would be {number(none)} off."
    labelled = _figure(rows[rows["statistic"] == LABELLED], "clothkit", by, name, column)
    said = [element("p", f"as labelled: {number(labelled)}", class_="against")] if not math.isnan(labelled) else []
    return element(
        "div",
        element("p", title, class_="title"),
        element("p", number(own), class_="big"),
        *said,
        element("p", f"{held} ", element("b", number(paper)), class_="against"),
        element("p", text, class_="meaning"),
        class_={"clothkit": "card won", "paper": "card lost"}.get(best or "", "card"),
    )


def _figure(rows: pd.DataFrame, source: str, by: str, name: str, column: str) -> float:
    found = rows.loc[(rows["source"] == source) & (rows[by] == name), column]
    return float(found.iloc[0]) if len(found) else math.nan
