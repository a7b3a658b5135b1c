"""Learning curves: validation errors of the nets during training."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator

from clothkit.report import panels

COLOURS = ("#3b75af", "#d9822b", "#519e3e")

NETS = (*COLOURS, "#8e5bd0", "#7a4a2b")
"""Colours of the members of an ensemble."""

TASKS = {"1/0": 0, "1/1": 0, "1/2": 0, "2/0": 1, "2/1": 1, "3/0": 2}
"""Columns of a forward model's history with validation errors, named length / start, and the index of their colour."""

STEPS = {"step_1": 0, "step_2": 1, "step_3": 2}
"""Columns of VtM's history with validation errors, by manipulations before the state, and the index of their colour."""


def curves(forward: Mapping[str, pd.DataFrame], vtm: pd.DataFrame, path: Path) -> None:
    """Writes charts of validation errors [cloth length] over iterations: forward models, VtM, then each model's tasks.

    Histories have the columns iteration and score, and may have those of TASKS or STEPS. The score of a forward model
    is the mean error over all six tasks, from true meshes; that of VtM is the mean error of its means after one to
    three manipulations.
    """
    names = list(forward)
    figure, axes = panels.chart(2 + len(names), width=3.8, height=2.9, columns=2)
    for axis in axes:
        axis.set_yscale("log")
        axis.set_xlabel("iteration", fontsize=8)
    histories = [*forward.values(), vtm]
    shown = [history[column] for history in histories for column in ("score", *TASKS, *STEPS) if column in history]
    # All panels have the same scale, so that they can be compared.
    limits = (0.9 * min(values.min() for values in shown), 1.1 * max(values.max() for values in shown))
    for axis in axes:
        axis.set_ylim(*limits)
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
        axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.yaxis.set_minor_formatter("")
        axis.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    scores = [(forward[name], "score", f"net {name}", colour) for name, colour in zip(names, cycle(NETS), strict=False)]
    _panel(axes[0], "forward models: score, the mean of six tasks", scores)
    states = [(vtm, column, f"state {column[-1]}", COLOURS[colour]) for column, colour in STEPS.items()]
    _panel(axes[1], "VtM: score, and by state", [(vtm, "score", "score", panels.INK), *states])
    for axis, name in zip(axes[2:], names, strict=True):
        tasks = [(forward[name], column, column, COLOURS[colour]) for column, colour in TASKS.items()]
        _panel(axis, f"net {name} by task: length / start", tasks)
    for axis in axes[::2]:
        axis.set_ylabel("validation error [cloth length]", fontsize=8)
    panels.save(figure, path)


def _panel(axis: Axes, title: str, lines: Sequence[tuple[pd.DataFrame, str, str, str]]) -> None:
    """Draws a line for each column that its history has; dots and labels show the validation with the best score."""
    axis.set_title(title, fontsize=9, color=panels.INK)
    present = [line for line in lines if line[1] in line[0]]
    ends = []
    for history, column, name, colour in present:
        best = history.iloc[int(history["score"].argmin())]
        axis.plot(history["iteration"], history[column], color=colour, linewidth=1.2)
        axis.plot(best["iteration"], best[column], "o", color=colour, markersize=3.5, clip_on=False, zorder=3)
        ends.append((float(history[column].iloc[-1]), f"{name}: {best[column]:.3f}", colour))
    axis.set_xlim(left=0, right=max((history["iteration"].max() for history, *_ in present), default=1))
    panels.label_ends(axis, ends)
