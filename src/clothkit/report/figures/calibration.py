"""Calibration: the share of errors below z sigma against that share for a normal distribution."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from clothkit.report import panels
from clothkit.report.figures.curves import COLOURS

LENGTHS = (1, 2, 3)

PANELS = (
    ("estimate", "all", "estimates"),
    ("main", "all", "predictions (main)"),
    ("main", "xy", "predictions (main): x and y alone"),
    ("main", "z", "predictions (main): z alone"),
)
"""System, axis and title."""


def calibration(tidy: pd.DataFrame, path: Path) -> None:
    """Writes charts of coverage against expected coverage in the test split: a line per length, with dots at one sigma.

    Columns of `tidy`: split, system, length, axis, z, expected, coverage. The length of an estimate is the number of
    manipulations before its state.
    """
    figure, axes = panels.chart(len(PANELS), width=3.4, height=3.3, columns=2)
    test = tidy[tidy["split"] == "test"]
    for axis, (system, coordinates, title) in zip(axes, PANELS, strict=True):
        _panel(axis, test[(test["system"] == system) & (test["axis"] == coordinates)])
        axis.set_title(title, fontsize=9, color=panels.INK)
    for axis in axes[::2]:
        axis.set_ylabel("share of errors below zσ", fontsize=8)
    for axis in axes[2:]:
        axis.set_xlabel("share under a normal distribution", fontsize=8)
    panels.save(figure, path)


def _panel(axis: Axes, rows: pd.DataFrame) -> None:
    axis.plot([0, 1], [0, 1], color="#999999", linewidth=0.9, linestyle=(0, (4, 3)))
    axis.set(xlim=(0, 1), ylim=(0, 1), aspect="equal")
    dots = []
    for length, colour in zip(LENGTHS, COLOURS, strict=True):
        line = rows[rows["length"] == length].sort_values("z")
        if line.empty:
            continue
        axis.plot([0, *line["expected"]], [0, *line["coverage"]], color=colour, linewidth=1.5)
        dot = line.iloc[int(np.argmin(np.abs(line["z"].to_numpy() - 1)))]
        axis.plot(dot["expected"], dot["coverage"], "o", color=colour, markersize=4)
        dots.append((dot["coverage"], dot["expected"], f"{length} manipulation{'s' if length > 1 else ''}", colour))
    if not dots:
        axis.text(0.5, 0.25, "none", fontsize=8, color=panels.INK)
        return
    # The text is in the corner without lines, in the same vertical order as the dots.
    below = sum(coverage < expected for coverage, expected, *_ in dots) > len(dots) / 2
    x, y = (0.04, 0.7) if below else (0.55, 0.1)
    for place, (coverage, _, name, colour) in enumerate(sorted(dots)):
        axis.text(x, y + 0.075 * place, f"{name}: {coverage:.2f}", color=colour, fontsize=8, va="center")
    heading = f"below 1σ ({dots[0][1]:.2f}):"
    axis.text(x, y + 0.075 * len(dots), heading, color=panels.INK, fontsize=8, va="center")
