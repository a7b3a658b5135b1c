"""Figures of doubt: what tells the errors of probes, and expected errors against real ones."""

from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes

from clothkit.planning.trust import INTERVAL
from clothkit.report import panels
from clothkit.report.doubt_tables import inside
from clothkit.report.figures.curves import NETS
from clothkit.report.layout import PROBED

NAMES = {
    "deviations": "u of eq. (15)",
    "conditional": "z of the state",
    "distance": "nets' distance",
    "sigma": "predicted sigma",
    "surprise": "surprise",
    "expected": "expected error",
}
STATISTICS = {
    "wrong": ("AUROC: errors above 0.08", 0.5),
    "off_support": ("AUROC: unlike what was recorded", 0.5),
    "rank": ("rank correlation with the error", 0.0),
}
"""Titles of the statistics of `evaluation.doubt`, and what a measure comes to that tells nothing."""

COLOURS = (*NETS, "#c2528b")
"""Colours of measures, in order."""

LEAST = 0.003
"""Errors below are drawn at that place [cloth length]."""


def measures(summary: pd.DataFrame, path: Path) -> None:
    """Writes charts of each statistic by group of probes: a dot per measure, with its interval. See `doubt.summary`."""
    figure, axes = panels.chart(len(STATISTICS), width=7.4, height=2.3, columns=1)
    shown = [name for name in NAMES if name in set(summary["measure"])]
    for axis, (statistic, (title, nothing)) in zip(axes, STATISTICS.items(), strict=True):
        own = summary[summary["statistic"] == statistic]
        axis.axhline(nothing, color="#999999", linewidth=0.9, linestyle=(0, (4, 3)))
        for place, (name, colour) in enumerate(zip(shown, COLOURS, strict=False)):
            rows = own[own["measure"] == name].set_index("group").reindex(list(PROBED))
            x = np.arange(len(PROBED)) + (place - (len(shown) - 1) / 2) * 0.13
            axis.vlines(x, rows["low"], rows["high"], color=colour, linewidth=1.4)
            axis.plot(x, rows["value"], "o", color=colour, markersize=4, label=NAMES[name])
        axis.set_xticks(range(len(PROBED)), PROBED)
        axis.set_title(title, fontsize=9, color=panels.INK)
        axis.set_ylim(min(nothing, float(own["low"].min())) - 0.05, 1.02)
    figure.legend(
        *axes[0].get_legend_handles_labels(),
        fontsize=7.5,
        ncols=len(shown),
        loc="outside upper center",
        frameon=False,
        columnspacing=1.0,
    )
    panels.save(figure, path)


def trust(probes: pd.DataFrame, plans: pd.DataFrame, path: Path) -> None:
    """Writes charts of expected against real errors, of probes' predictions and of plans; the band holds INTERVAL."""
    figure, axes = panels.chart(2, width=3.6, height=3.6)
    kinds = [(name, probes["kind"] == name) for name in dict.fromkeys(probes["kind"])]
    lengths = [(f"{n} manipulation{'' if n == 1 else 's'}", plans["length"] == n) for n in sorted(set(plans["length"]))]
    _scatter(axes[0], probes["expected"].to_numpy(float), probes["error"].to_numpy(float), kinds)
    _scatter(axes[1], plans["trusted_error"].to_numpy(float), plans["error"].to_numpy(float), lengths)
    ratio = (plans["trusted_low"] / plans["trusted_error"], plans["trusted_high"] / plans["trusted_error"])
    low, high = (float(each.median()) for each in ratio)
    if np.isfinite([low, high]).all():
        ends = np.array(axes[1].get_xlim())
        axes[1].fill_between(ends, ends * low, ends * high, color="#bbbbbb", alpha=0.25, linewidth=0, zorder=0)
        share = inside(plans[plans["trusted_error"].notna()]).mean()
        text = f"{share:.0%} in the band of {INTERVAL:.0%}"
        axes[1].text(0.97, 0.04, text, transform=axes[1].transAxes, ha="right", fontsize=8, color=panels.INK)
    for axis, title in zip(axes, ("predictions of probes", "outcomes of plans"), strict=True):
        axis.set_title(title, fontsize=9, color=panels.INK)
        axis.set_xlabel("expected error", fontsize=8)
    axes[0].set_ylabel("real error", fontsize=8)
    panels.save(figure, path)


def _scatter(
    axis: Axes,
    expected: Float[np.ndarray, " rows"],
    real: Float[np.ndarray, " rows"],
    groups: list[tuple[str, pd.Series]],
) -> None:
    for (name, chosen), colour in zip(groups, NETS, strict=False):
        rows = chosen.to_numpy(bool) & np.isfinite(expected)
        axis.plot(
            np.maximum(expected[rows], LEAST), np.maximum(real[rows], LEAST), "o", color=colour, markersize=3,
            alpha=0.6, markeredgewidth=0, label=name,
        )  # fmt: skip
    most = max(0.5, *(float(np.nanmax(values, initial=0)) for values in (expected, real))) * 1.2
    axis.plot([LEAST, most], [LEAST, most], color="#999999", linewidth=0.9, linestyle=(0, (4, 3)))
    axis.set(xscale="log", yscale="log", xlim=(LEAST * 0.8, most), ylim=(LEAST * 0.8, most), aspect="equal")
    axis.legend(fontsize=7, loc="upper left", frameon=False, handletextpad=0.1)
