"""Formats figures, and decides which of two is better, for the Markdown page and the HTML page."""

import math
from collections.abc import Collection
from typing import Literal

import pandas as pd

from clothkit.report.layout import HIGH, LOW

IDEAL_RATIO = 0.798
"""Ideal sigma ratio."""

JUDGED: Collection[str] = ("mean", "median")
"""Statistics for which less is better. A spread is neither better nor worse."""

LEAST = 10
"""Least number of sequences for which intervals and p are printed; evaluations compute none for fewer, either."""

TOO_FEW = "too few"
"""Printed in place of intervals and p from fewer than LEAST sequences."""

SOURCES = ("clothkit", "paper")


def number(value: float) -> str:
    """The value with three significant digits, as in the paper; a dash for NaN."""
    return "–" if pd.isna(value) else f"{value:#.3g}".rstrip(".")


def statistic(name: str, value: float) -> str:
    """A figure of the statistic `name`. A missing end of an interval is printed as TOO_FEW."""
    return TOO_FEW if pd.isna(value) and name in (LOW, HIGH) else number(value)


def better(own: float, paper: float, *, ideal: float = -math.inf) -> Literal["clothkit", "paper"] | None:
    """The source whose figure, as printed, is nearer to `ideal`; by default, whose figure is less.

    None if both are equally near or one is NaN.
    """
    if math.isnan(own) or math.isnan(paper):
        return None
    shown = [float(number(value)) for value in (own, paper)]
    distances = shown if math.isinf(ideal) else [abs(value - ideal) for value in shown]
    if math.isclose(*distances):
        return None
    return "paper" if distances[1] < distances[0] else "clothkit"
