"""How figures are printed, and which of two is the better one: the same in Markdown and in HTML."""

import math
from collections.abc import Collection
from typing import Literal

import pandas as pd

from clothkit.report.layout import HIGH, LOW

IDEAL_RATIO = 0.798
"""Of sigma ratios."""

JUDGED: Collection[str] = ("mean", "median")
"""Statistics of which less is better; a spread is neither better nor worse."""

LEAST = 10
"""Sequences without which neither an interval nor a p is printed; evaluations leave them out, too."""

TOO_FEW = "too few"
"""Printed in place of them."""

SOURCES = ("clothkit", "paper")


def number(value: float) -> str:
    """Three significant digits, as the paper has them; a dash for what was not measured."""
    return "–" if pd.isna(value) else f"{value:#.3g}".rstrip(".")


def statistic(name: str, value: float) -> str:
    """A figure in a row of that name: an end of an interval that is missing is one of too few sequences."""
    return TOO_FEW if pd.isna(value) and name in (LOW, HIGH) else number(value)


def better(own: float, paper: float, *, ideal: float = -math.inf) -> Literal["clothkit", "paper"] | None:
    """Which of the two is nearer to the ideal as they are printed; None if neither is. By default less is better."""
    if math.isnan(own) or math.isnan(paper):
        return None
    shown = [float(number(value)) for value in (own, paper)]
    distances = shown if math.isinf(ideal) else [abs(value - ideal) for value in shown]
    if math.isclose(*distances):
        return None
    return "paper" if distances[1] < distances[0] else "clothkit"
