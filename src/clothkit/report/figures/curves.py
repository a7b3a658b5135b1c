"""Learning curves: validation scores of the nets while they were trained."""

from collections.abc import Mapping
from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator

from clothkit.report import panels

COLOURS = ("#3b75af", "#d9822b", "#519e3e")


def curves(forward: Mapping[str, pd.DataFrame], vtm: pd.DataFrame, path: Path) -> None:
    """Validation score [cloth length] over iterations: the forward models beside each other, then VtM.

    Histories have the columns iteration and score (that of a forward model: mean error over all six tasks, from true
    meshes; of VtM: mean error of its means).
    """
    figure, (left, right) = panels.chart(2, width=3.4)
    for (name, history), colour in zip(sorted(forward.items()), COLOURS, strict=False):
        _curve(left, history, colour, f"net {name}")
    _curve(right, vtm, COLOURS[2], "VtM")
    left.set_title("forward models (all six tasks)", fontsize=9)
    right.set_title("VtM", fontsize=9)
    left.set_ylabel("validation error [cloth length]", fontsize=8)
    panels.save(figure, path)


def _curve(axis: Axes, history: pd.DataFrame, colour: str, name: str) -> None:
    best = history.iloc[int(history["score"].argmin())]
    axis.plot(
        history["iteration"], history["score"], color=colour, linewidth=1.5, label=f"{name}: best {best['score']:.4f}"
    )
    axis.plot(best["iteration"], best["score"], "o", color=colour, markersize=4)
    axis.set_yscale("log")
    axis.set_xlabel("iteration", fontsize=8)
    axis.set_xlim(left=0)
    axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.yaxis.set_major_formatter("{x:g}")
    axis.yaxis.set_minor_formatter("")
    axis.legend(fontsize=8, frameon=False)
