"""The figures of the studies of doubt: planning error by measure of uncertainty, data and number of nets."""

from itertools import product
from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes

from clothkit.report import panels
from clothkit.report.figures.studies import QUIET

MEASURES = {
    "paper": ("eq. (15)", "#3b75af"),
    "conditional": ("conditional", "#519e3e"),
    "support": ("support", "#8e5bd0"),
    "expected": ("expected error", "#d9822b"),
    "b2": ("one net", "#777777"),
}
"""Labels and colours of measures of uncertainty, in order."""

UNDOUBTED = {"paper": "no doubt, eq. (13)", "expected": "no doubt, cloth lengths"}
"""Labels without doubt, by the accuracy term that goes with the measure."""


def doubt(table: pd.DataFrame, path: Path) -> None:
    """Writes charts of the error by measure of uncertainty, a row for each rule and a column for each plan length.

    Points are means with 95 % intervals; a star marks a paired difference with p < 0.01. Columns of `table`: system,
    measure, alpha, fold, column (length/all), error [cloth length], low, high and difference_p.
    """
    # System b2 has one net, and no doubt.
    table = table.assign(measure=table["measure"].mask(table["system"] == "b2", "b2"))
    columns, rules = sorted(table["column"].unique()), _rules(table)
    figure, axes = panels.chart(len(rules) * len(columns), width=3.0, height=2.7, columns=len(columns))
    variants = [
        (name, alpha) for name in MEASURES for alpha in sorted(table.loc[table["measure"] == name, "alpha"].unique())
    ]
    for axis, (fold, column) in zip(axes, product(rules, columns), strict=True):
        rows = table[(table["fold"].astype(bool) == fold) & (table["column"] == column)]
        for place, (name, alpha) in enumerate(variants):
            for row in rows[(rows["measure"] == name) & (rows["alpha"] == alpha)].to_dict("records"):
                label, colour = MEASURES[name]
                label = UNDOUBTED.get(name, label) if alpha == 0 else label
                spread = ([row["error"] - row["low"]], [row["high"] - row["error"]])
                filled = "white" if alpha == 0 else colour
                axis.errorbar([place], [row["error"]], yerr=spread, fmt="o", color=colour, markersize=4.5,
                              markerfacecolor=filled, linewidth=1.1, label=label)  # fmt: skip
                if row["difference_p"] < 0.01:
                    axis.text(place, row["high"], "*", ha="center", va="bottom", fontsize=10, color=panels.INK)
                if (name, alpha) == variants[0]:
                    axis.axhline(row["error"], color=QUIET, linewidth=0.8, linestyle=(0, (1, 2)))
        axis.set_xticks(range(len(variants)), [f"{alpha:g}" for _, alpha in variants], fontsize=7)
        _title(axis, fold, column)
    _label(axes, len(columns), "alpha")
    entries = {label: bars for axis in axes for bars, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(entries.values(), entries, fontsize=8, frameon=False, loc="outside upper center", ncols=4)
    panels.save(figure, path)


def amounts(table: pd.DataFrame, path: Path) -> None:
    """Writes charts of the error by training sequences and nets, a row for each rule and a column for each plan length.

    Points are means with 95 % intervals; a star marks a paired difference to no doubt with p < 0.01. Columns of
    `table`: amount (training sequences), nets, and those of `doubt`.
    """
    columns, rules = sorted(table["column"].unique()), _rules(table)
    figure, axes = panels.chart(len(rules) * len(columns), width=3.0, height=2.7, columns=len(columns))
    settings = sorted(set(zip(table["amount"], table["nets"], strict=True)))
    variants = list(dict.fromkeys(zip(table["measure"], table["alpha"], strict=True)))
    for axis, (fold, column) in zip(axes, product(rules, columns), strict=True):
        rows = table[(table["fold"].astype(bool) == fold) & (table["column"] == column)]
        for shift, (name, alpha) in enumerate(variants, start=-1):
            label, colour = MEASURES[name] if alpha else ("no doubt", "#777777")
            own = rows[(rows["measure"] == name) & (rows["alpha"] == alpha)].set_index(["amount", "nets"])
            found = [(place, own.loc[setting]) for place, setting in enumerate(settings) if setting in own.index]
            places = [place + 0.16 * shift for place, _ in found]
            spread = [[row[a] - row[b] for _, row in found] for a, b in (("error", "low"), ("high", "error"))]
            axis.errorbar(places, [row["error"] for _, row in found], yerr=spread, fmt="o", color=colour,
                          markersize=4, linewidth=1.1, label=label)  # fmt: skip
            for place, (_, row) in zip(places, found, strict=True):
                if row["difference_p"] < 0.01:
                    axis.text(place, row["high"], "*", ha="center", va="bottom", fontsize=10, color=panels.INK)
        axis.set_xticks(range(len(settings)), [f"{amount}\n{nets}" for amount, nets in settings], fontsize=7)
        _title(axis, fold, column)
    _label(axes, len(columns), "training sequences, and nets below")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, frameon=False, loc="outside upper center", ncols=4)
    panels.save(figure, path)


def _rules(table: pd.DataFrame) -> list[bool]:
    return sorted({bool(fold) for fold in table["fold"]}, reverse=True)


def _title(axis: Axes, fold: bool, column: str) -> None:
    """Name the plan length and the rule of a chart of errors from 0, with room for a star above the highest point."""
    axis.margins(y=0.12)
    axis.set_ylim(bottom=0)
    axis.grid(visible=False, axis="x")
    many = "1 manipulation" if column[0] == "1" else f"{column[0]} manipulations"
    rule = "folds as recorded" if fold else "any first manipulation"
    axis.set_title(f"{many}, {rule}", fontsize=8.5, color=panels.INK)


def _label(axes: list[Axes], columns: int, below: str) -> None:
    """Label the axes of rows of charts of errors."""
    for axis in axes[::columns]:
        axis.set_ylabel("error of the outcome\n[cloth length]", fontsize=8)
    for axis in axes[-columns:]:
        axis.set_xlabel(below, fontsize=8)
