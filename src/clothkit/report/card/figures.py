"""Pictures of the card: histograms, sequences drawn at random, the worst states."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, PercentFormatter

from clothkit.report import panels
from clothkit.report.card.inputs import Example
from clothkit.report.card.measures import HISTOGRAMS, WORST, Measure, of_name
from clothkit.report.card.tables import STEPS, spread
from clothkit.report.draw import EXTENT, draw, draw_relief, relief_colours
from clothkit.report.figures.curves import COLOURS
from clothkit.report.figures.sequences import Strip, draw_strips

BINS = 36

CLOSE = 340
"""Side of a picture before it is cropped to the cloth [pixels]."""


def histograms(states: pd.DataFrame, limits: Mapping[str, float], path: Path) -> None:
    """Writes a figure with a histogram per measure: shares of the states after each step, and the limit, dashed."""
    figure, axes = panels.chart(len(HISTOGRAMS), width=2.9, height=2.05, columns=3)
    for axis, measure in zip(axes, HISTOGRAMS, strict=True):
        samples = [spread(states.loc[states["state"] == k, measure.name], measure) for k in STEPS]
        limit = limits[measure.name] * measure.factor if measure.name in limits else None
        _histogram(axis, samples, measure, limit)
        axis.set_title(measure.title, fontsize=8.5, color=panels.INK)
    lines = [Line2D([], [], color=colour, label=f"after step {k}") for k, colour in zip(STEPS, COLOURS, strict=True)]
    axes[0].legend(handles=lines, fontsize=7.5, frameon=False, handlelength=1.2)
    panels.save(figure, path)


def _histogram(axis: Axes, samples: Sequence[Sequence[float]], measure: Measure, limit: float | None) -> None:
    found = np.concatenate([np.asarray(sample, float) for sample in samples])
    if not len(found):
        axis.text(0.5, 0.5, "not recorded", transform=axis.transAxes, fontsize=8, color=panels.INK, ha="center")
        axis.set(xticks=[], yticks=[])
        return
    if measure.name == "folds":
        edges = np.arange(found.min() - 0.5, found.max() + 1).tolist()
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    else:
        # Values that are all equal need a range of some width to be visible.
        slack = 0.5 * max(0.1 * np.abs(found).max() - np.ptp(found), 0)
        edges = np.linspace(found.min() - slack, found.max() + slack + 1e-9, BINS + 1).tolist()
    for sample, colour in zip(samples, COLOURS, strict=True):
        if not len(sample):
            continue
        shares = np.full(len(sample), 1 / len(sample))
        axis.hist(sample, edges, weights=shares, color=colour, alpha=0.16)
        axis.hist(sample, edges, weights=shares, color=colour, histtype="step", linewidth=1.3)
    if limit is not None:
        axis.axvline(limit, color="#c62828", linewidth=1.2, linestyle=(0, (3, 2)))
        at_left = abs(limit - axis.get_xlim()[0]) < abs(limit - axis.get_xlim()[1])
        axis.annotate(
            f"limit {limit:g}",
            (limit, 0.97),
            xycoords=("data", "axes fraction"),
            xytext=(3 if at_left else -3, 0),
            textcoords="offset points",
            fontsize=7,
            color="#c62828",
            ha="left" if at_left else "right",
            va="top",
        )
    axis.yaxis.set_major_formatter(PercentFormatter(1, decimals=0))
    axis.yaxis.set_major_locator(MaxNLocator(4))


def sequences(examples: Sequence[Example], path: Path) -> None:
    """Writes a figure of sequences of up to four states, two per row, with numbers, manipulations and heights."""
    strips = [Strip(e.meshes, e.manipulations, f"sequence {e.sequence}") for e in examples]
    draw_strips(strips, path, title="Sequences drawn at random: states, manipulations, heights (normalised)")


def worst(rows: pd.DataFrame, examples: Mapping[int, Example], path: Path, *, highest: float) -> None:
    """Writes a figure of the worst states: a column per measure, each state from above and coloured by height.

    Below each state is the measure's value and its rank; `highest` [normalised] is the upper end of the colours.
    """
    names = [name for name in WORST if (rows["measure"] == name).any()]
    depth = int(rows.groupby("measure").size().max()) if len(rows) else 0
    if not depth:
        return
    figure, axes = panels.sheet([0.14, *[1.0, 1.0, 0.42] * depth], [1.0] * len(names) + [0.42], left=0.1)
    for column, name in enumerate(names):
        axes[0, column].text(0.5, 0.1, WORST[name], fontsize=7.5, fontweight="bold", color=panels.INK, ha="center")
        for place, (_, row) in enumerate(rows[rows["measure"] == name].iterrows()):
            mesh = examples[row["sequence"]].meshes[row["state"]]
            above, relief, text = axes[1 + 3 * place : 4 + 3 * place, column]
            mesh = mesh - np.append((mesh.max((0, 1)) + mesh.min((0, 1)))[:2] / 2, 0).astype(np.float32)
            panels.show(above, _close(draw(mesh, pixels=CLOSE), mesh))
            panels.show(relief, _close(draw_relief(mesh, highest=highest, pixels=CLOSE), mesh))
            text.text(0.5, 0.9, _caption(row, of_name(name)), fontsize=7, color=panels.INK, ha="center", va="top")
    _scale(axes[2, -1], highest)
    panels.save(figure, path)


def _close(picture: UInt8[np.ndarray, "r c 3"], mesh: Float[np.ndarray, "u v 3"]) -> UInt8[np.ndarray, "rr cc 3"]:
    """A picture cropped about its middle to the size of the cloth."""
    middle = len(picture) // 2
    half = min(middle, round(1.1 * float(np.abs(mesh[..., :2]).max()) / EXTENT * middle))
    return picture[middle - half : middle + half, middle - half : middle + half]


def _caption(row: pd.Series, measure: Measure) -> str:
    unit = "" if measure.unit == "normalised" else f" {measure.unit}"
    value = f"{row['value'] * measure.factor:.3g}{unit}"
    return f"{value} (no. {row['rank']})\nsequence {row['sequence']}, state {row['state']}"


def _scale(axis: Axes, highest: float) -> None:
    """Draws the colour scale of heights beside the pictures."""
    shades = relief_colours(np.linspace(1, 0, 64)[:, None])
    axis.set_axis_on()
    axis.imshow(shades, extent=(0, 1, 0, highest), aspect="auto", interpolation="none")
    # A third of the column is colour, the rest is for the numbers.
    axis.set_xlim(0, 3)
    axis.spines[:].set_visible(False)
    axis.set(xticks=[], yticks=[])
    for height in (0, highest / 2, highest):
        axis.text(1.15, height, f"{height:.3g}", fontsize=6.5, color=panels.INK, va="center")
