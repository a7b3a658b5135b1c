"""Figures of the studies: validation error by training time, planning error by weights, search and number of nets."""

from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator

from clothkit.evaluation.comparisons import interval
from clothkit.report import panels
from clothkit.report.figures.curves import COLOURS

SYMBOLS = {"alpha": "α", "beta": "β", "gamma": "γ"}
QUIET = "#b5b5b5"
SHOWN = 6
"""Number of variants that are named in a figure; the others are grey."""


def recipes(table: pd.DataFrame, path: Path, *, base: str = "base", unit: str = "cloth length") -> None:
    """Writes a chart of validation score [`unit`] against CPU minutes, with a line per variant.

    The best variants and `base` are named. Columns of `table`: variant, seed, minutes, score. For several seeds, mean
    and range are drawn.
    """
    figure, (axis,) = panels.chart(1, width=6.4, height=3.6)
    best = table.groupby(["variant", "seed"])["score"].min().groupby("variant").mean().sort_values()
    named = [*best.index[:SHOWN], *([base] if base in best.index[SHOWN:] else [])]
    ends = []
    for variant in best.index[::-1]:
        runs = table[table["variant"] == variant].assign(check=lambda rows: rows.groupby("seed").cumcount())
        by_check = runs.groupby("check").agg({"minutes": "mean", "score": ["mean", "min", "max"]})
        minutes, score = by_check["minutes", "mean"], by_check["score", "mean"]
        place = named.index(variant) if variant in named else -1
        colour = COLOURS[place % len(COLOURS)] if place >= 0 else QUIET
        style = "-" if place < len(COLOURS) else "--"
        axis.plot(minutes, score, style, color=colour, linewidth=1.3 if place >= 0 else 0.7)
        if runs["seed"].nunique() > 1:
            axis.fill_between(minutes, by_check["score", "min"], by_check["score", "max"], color=colour, alpha=0.15)
        if place >= 0:
            ends.append((float(score.iloc[-1]), f"{variant}: {best[variant]:.4f}", colour))
    axis.set_yscale("log")
    axis.set_xlim(left=0, right=float(table["minutes"].max()))
    axis.set_ylim(0.95 * float(table["score"].min()), min(0.4, 1.05 * float(table["score"].max())))
    axis.yaxis.set_major_locator(LogLocator(subs=(0.6, 0.7, 0.8, 1.0, 1.2, 1.5, 2.0, 3.0, 4.0)))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.yaxis.set_minor_formatter("")
    axis.set_xlabel("CPU minutes", fontsize=8)
    axis.set_ylabel(f"validation score [{unit}]", fontsize=8)
    panels.label_ends(axis, ends, least=0.06)
    panels.save(figure, path)


def weights(table: pd.DataFrame, usual: Mapping[str, float], path: Path) -> None:
    """Writes charts of planning error [cloth length] against each of alpha, beta and gamma, a line per plan length.

    The other two weights have the values in `usual`. There is a row of charts per weight and a column per state from
    which plans start; a dotted line marks the usual value. Lines are means, with 95 % bootstrap intervals over
    sequences. Columns of `table`: alpha, beta, gamma, sequence, start, length, error.
    """
    starts = (0, 1, 2)
    figure, axes = panels.chart(len(SYMBOLS) * len(starts), width=3.0, height=2.3, columns=len(starts))
    varied = [name for name in SYMBOLS if _varying(table, usual, name)[name].nunique() > 1] or list(SYMBOLS)
    highest = 0.0
    for number, (name, start) in enumerate(product(SYMBOLS, starts)):
        axis, rows = axes[number], _varying(table, usual, name)
        if name not in varied:
            axis.set_visible(False)
            continue
        values = np.sort(rows[name].unique())
        for length, colour in list(zip((1, 2, 3), COLOURS, strict=True))[: 3 - start]:
            own = rows[(rows["start"] == start) & (rows["length"] == length)]
            found = [_mean(own[own[name] == value]) for value in values]
            mean, low, high = np.array(found).T
            axis.plot(range(len(values)), mean, "o-", color=colour, linewidth=1.2, markersize=3.5, label=f"{length}")
            axis.fill_between(range(len(values)), low, high, color=colour, alpha=0.13, linewidth=0)
            highest = max(highest, float(np.nanmax([0.0, *high])))
        in_force = np.flatnonzero(np.isclose(values, usual[name]))
        for place in in_force.tolist():
            axis.axvline(place, color=panels.INK, linewidth=0.9, linestyle=(0, (1, 2)), zorder=0)
        axis.set_xticks(range(len(values)), [f"{value:g}" for value in values])
        axis.set_xlabel(SYMBOLS[name], fontsize=9)
        if start == 0:
            axis.set_ylabel("planning error\n[cloth length]", fontsize=8)
        if name == next(iter(varied)):
            axis.set_title(f"from state {start}", fontsize=9, color=panels.INK)
    for axis in axes:
        axis.set_ylim(0, 1.05 * highest or 1.0)
    handles, labels = axes[starts[0] + len(starts) * list(SYMBOLS).index(varied[0])].get_legend_handles_labels()
    handles.append(Line2D([], [], color=panels.INK, linewidth=0.9, linestyle=(0, (1, 2))))
    labels = [*(f"{label} manipulation{'s' if label > '1' else ''}" for label in labels), "in force"]
    figure.legend(handles, labels, fontsize=8, frameon=False, loc="outside upper center", ncols=len(labels))
    panels.save(figure, path)


def _varying(table: pd.DataFrame, usual: Mapping[str, float], name: str) -> pd.DataFrame:
    """The rows in which all weights but `name` have their usual values."""
    others = [np.isclose(table[other], usual[other]) for other in SYMBOLS if other != name]
    return table[np.all(others, axis=0)]


def _mean(rows: pd.DataFrame) -> Float[np.ndarray, "3"]:
    by_sequence: Any = rows.groupby("sequence")["error"].agg(["sum", "count"])
    total, count = by_sequence["sum"].to_numpy(float), by_sequence["count"].to_numpy(float)
    if not len(total):
        return np.full(3, np.nan)
    return np.array([total.sum() / count.sum(), *interval(total, count)])


ITERATIONS = ["base_iterations", "iterations_per_step"]
OTHERS = {
    "vertices": ("s", ["stride"]),
    "restarts": ("^", ["near"]),
    "kinds of manipulations": ("D", ["fold"]),
}
"""Settings, beside strains and iterations, in which searches differ: the marker and the columns of each."""


def search(table: pd.DataFrame, usual: Mapping[str, Any], path: Path) -> None:
    """Writes charts of error, search failures and loss of first plans against the cost of a plan.

    The cost is the number of evaluations of the planning loss, because the time of few plans is mostly that of
    compilation. `usual` has the values in force of the columns strains, ITERATIONS and OTHERS. Solid lines, one per
    plan length, vary the strains of the usual search; dashed lines do so with other iterations; markers off the lines
    are searches with one other setting. Columns of `table`: the settings, length, error [cloth length],
    loss, loss_recorded, evaluations.
    """
    figure, axes = panels.chart(3, width=3.0, height=2.9)
    table = table.assign(failure=table["loss_recorded"] < table["loss"])
    titles = {
        "error": "planning error [cloth length]",
        "failure": "share of search failures",
        "loss": "loss of the first plan",
    }
    for axis, (column, title) in zip(axes, titles.items(), strict=True):
        for length, colour in zip((1, 2, 3), COLOURS, strict=True):
            means = table[table["length"] == length].groupby(list(usual))[["evaluations", column]].mean().reset_index()
            line = _differing(means, usual, ["strains"]).sort_values("evaluations")
            axis.plot(
                line["evaluations"], line[column], "o-", color=colour, linewidth=1.2, markersize=3.5, label=f"{length}"
            )
            for _, other in _differing(means, usual, ["strains", *ITERATIONS]).groupby(ITERATIONS):
                if (other[ITERATIONS] != pd.Series({name: usual[name] for name in ITERATIONS})).any(axis=None):
                    other = other.sort_values("evaluations")
                    axis.plot(other["evaluations"], other[column], "x--", color=colour, linewidth=0.8, markersize=4.5)
            for marker, columns in OTHERS.values():
                others = _differing(means, usual, columns)
                others = others[(others[columns] != pd.Series({name: usual[name] for name in columns})).any(axis=1)]
                axis.plot(others["evaluations"], others[column], marker, color=colour, markersize=4.5, fillstyle="none")
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
        axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        axis.xaxis.set_minor_formatter("")
        axis.set_xlabel("evaluations of the loss per plan", fontsize=8)
        axis.set_ylabel(title, fontsize=8)
        if column != "loss":
            axis.set_ylim(bottom=0)
    styles = {"iterations": ("x", ITERATIONS), **OTHERS}
    marks = {name: marker for name, (marker, of) in styles.items() if (table[of].nunique() > 1).any()}
    handles = [
        Line2D([], [], color=QUIET, marker=marker, linestyle="", fillstyle="none", markersize=4.5)
        for marker in marks.values()
    ]
    lengths, names = axes[0].get_legend_handles_labels()
    names = [f"{name} manipulation{'s' if name > '1' else ''}" for name in names]
    entries = ([*lengths, *handles], [*names, *(f"other {name}" for name in marks)])
    figure.legend(*entries, fontsize=8, frameon=False, loc="outside upper center", ncols=len(entries[1]))
    panels.save(figure, path)


def _differing(means: pd.DataFrame, usual: Mapping[str, Any], columns: list[str]) -> pd.DataFrame:
    """The searches whose settings are the usual ones in all columns but `columns`."""
    others = [means[name] == value for name, value in usual.items() if name not in columns]
    return means[np.all(others, axis=0)]


ENSEMBLES = {
    "error": "planning error [cloth length]",
    "prediction_error": "prediction error [cloth length]",
    "failure": "share of search failures",
    "uncertainty": "u of the first plan",
    "seconds": "search per plan [s]",
    "training_minutes": "training [CPU minutes]",
}
"""Measures of the study of ensembles that are drawn, and their labels."""


def ensemble(table: pd.DataFrame, path: Path) -> None:
    """Writes charts of errors, search failures, uncertainty and costs against the number of nets of an ensemble.

    There is a line per plan length, or a single one for a measure without lengths, with 95 % intervals where there are
    any. Columns of `table`: nets, measure (of ENSEMBLES), column (length/all, or all), mean, low, high.
    """
    figure, axes = panels.chart(len(ENSEMBLES), width=3.0, height=2.5, columns=3)
    for axis, (measure, title) in zip(axes, ENSEMBLES.items(), strict=True):
        own = table[table["measure"] == measure].sort_values("nets")
        for column, colour in (*((f"{length}/all", COLOURS[length - 1]) for length in (1, 2, 3)), ("all", panels.INK)):
            line = own[own["column"] == column]
            axis.plot(line["nets"], line["mean"], "o-", color=colour, linewidth=1.2, markersize=3.5)
            axis.fill_between(line["nets"], line["low"], line["high"], color=colour, alpha=0.13, linewidth=0)
        axis.set_xticks(np.sort(table["nets"].unique()))
        axis.set_xlabel("nets", fontsize=8)
        axis.set_ylabel(title, fontsize=8)
        if measure != "uncertainty":
            axis.set_ylim(bottom=0)
    handles = [Line2D([], [], marker="o", markersize=3.5, color=colour) for colour in COLOURS]
    names = [f"{length} manipulation{'s' if length > 1 else ''}" for length in (1, 2, 3)]
    figure.legend(handles, names, fontsize=8, frameon=False, loc="outside upper center", ncols=len(names))
    panels.save(figure, path)


TOLD = ("1", "2", "3")


def plan_length(table: pd.DataFrame, path: Path) -> None:
    """Writes charts of error against executed manipulations, one per split and system, a colour per recorded length.

    Lines join the sessions with one, two and three manipulations; a diamond marks those in which the agent chose, with
    the 95 % interval of its error, a ring those with the recorded number, a cross that nothing is done. Columns of
    `table`: split, system, steps (1, 2, 3, given, chosen), column (1/all, ..), used, error, error_low, error_high,
    error_no_action.
    """
    groups = list(table.groupby(["split", "system"], sort=False))
    figure, axes = panels.chart(len(groups), width=4.2, height=3.2, columns=min(len(groups), 3))
    for axis, ((split, system), own) in zip(axes, groups, strict=True):
        rows = own.set_index(["steps", "column"]).sort_index()
        for length, colour in zip(TOLD, COLOURS, strict=True):
            ways = own["steps"].unique()
            of = {steps: rows.loc[(steps, f"{length}/all")] for steps in ways if (steps, f"{length}/all") in rows.index}
            told = [of[steps] for steps in TOLD if steps in of]
            axis.plot([row["used"] for row in told], [row["error"] for row in told], ".-", color=colour, linewidth=1.0)
            if told:
                axis.plot(0, told[0]["error_no_action"], "x", color=colour, markersize=5)
            if "given" in of:
                given = of["given"]
                axis.plot(given["used"], given["error"], "o", color=colour, fillstyle="none", markersize=8)
            if "chosen" in of:
                chosen = of["chosen"]
                apart = [[chosen["error"] - chosen["error_low"]], [chosen["error_high"] - chosen["error"]]]
                axis.errorbar(chosen["used"], chosen["error"], yerr=apart, fmt="D", color=colour, markersize=6)
        axis.set_xlim(left=-0.1)
        axis.set_ylim(bottom=0)
        axis.set_xlabel("manipulations that were executed", fontsize=8)
        axis.set_ylabel("error of the outcome [cloth length]", fontsize=8)
        axis.set_title(f"{system}, {split} split", fontsize=8.5, color=panels.INK)
    marks: dict[str, dict[str, Any]] = {
        "chosen": {"marker": "D"},
        "as recorded": {"marker": "o", "fillstyle": "none"},
        "1, 2, 3": {"marker": "."},
        "nothing done": {"marker": "x"},
    }
    handles = [Line2D([], [], color=QUIET, linestyle="", **mark) for mark in marks.values()]
    handles += [Line2D([], [], color=colour, linewidth=1.5) for colour in COLOURS]
    labels = [*marks, *(f"goal of {length}" for length in TOLD)]
    figure.legend(handles, labels, fontsize=7.5, frameon=False, loc="outside upper center", ncols=4)
    panels.save(figure, path)


OPTIMISERS = {
    "gradient": ("gradient (reference)", COLOURS[0], "o"),
    "gradient_paper": ("gradient, the paper's rules", "#8fb4d6", "o"),
    "hybrid": ("hybrid: CEM, then gradient", "#c0392b", "D"),
    "cem": ("CEM", COLOURS[2], "s"),
    "mppi": ("MPPI", "#8e5bd0", "s"),
    "greedy": ("greedy", "#7a4a2b", "^"),
    "shooting": ("random shooting", COLOURS[1], "v"),
    "shooting_500": ("random shooting, 500", "#eebf8f", "v"),
}
"""Name, colour and marker of each contestant."""

BUDGETS = {"evaluations": "as many evaluations", "seconds": "as many seconds"}


def optimisers(table: pd.DataFrame, path: Path) -> None:
    """Writes charts of the error and the search failures of optimisers by plan length, a row of charts per budget.

    Points are means with 95 % intervals; dotted lines continue the reference's. Columns of `table`: contestant (of
    OPTIMISERS), budget (of BUDGETS, or both), length, and for each of error [cloth length] and search_failures (share)
    the mean and, with _low and _high, its interval. A measure without values is said to be missing.
    """
    figure, axes = panels.chart(4, width=4.1, height=2.5, columns=2)
    lengths = np.sort(table["length"].unique())
    titles = {"error": "error of the outcome\n[cloth length]", "search_failures": "search failures [%]"}
    offsets = np.linspace(-0.34, 0.34, len(OPTIMISERS))
    for axis, (budget, (column, title)) in zip(axes, product(BUDGETS, titles.items()), strict=True):
        rows = table[table["budget"].isin([budget, "both"])].set_index(["contestant", "length"]).sort_index()
        scale = 100.0 if column == "search_failures" else 1.0
        for (name, (label, colour, marker)), offset in zip(OPTIMISERS.items(), offsets, strict=True):
            if name not in rows.index:
                continue
            own = scale * rows.loc[name].reindex(lengths)[[column, f"{column}_low", f"{column}_high"]]
            mean, low, high = own.to_numpy(float).T
            style: dict[str, Any] = {"color": colour, "markersize": 4.5, "linewidth": 1.1, "label": label}
            axis.errorbar(lengths + offset, mean, yerr=(mean - low, high - mean), fmt=marker, **style)
            if name == "gradient":
                axis.hlines(mean, lengths - 0.42, lengths + 0.42, color=colour, linewidth=0.8, linestyle=(0, (1, 2)))
        if rows[column].isna().all():
            axis.text(0.5, 0.5, "not executed", transform=axis.transAxes, ha="center", color=QUIET)
        axis.set_xticks(lengths)
        axis.set_xlim(lengths[0] - 0.5, lengths[-1] + 0.5)
        axis.set_ylim(bottom=0)
        axis.grid(visible=False, axis="x")
        axis.set_ylabel(title, fontsize=8)
        axis.set_title(f"{BUDGETS[budget]} as the reference", fontsize=8.5, color=panels.INK)
        axis.set_xlabel("manipulations of the plan", fontsize=8)
    entries = {label: bars for axis in axes for bars, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(entries.values(), entries, fontsize=8, frameon=False, loc="outside upper center", ncols=4)
    panels.save(figure, path)


REACH = {
    "turning": ("turning alone", COLOURS[1], "s"),
    "terms": ("turning, else a search within reach", COLOURS[0], "o"),
}
"""Name, colour and marker of each way of keeping plans within reach."""

REGIONS = {
    "square": "hands at most so far from the middle, in x and in y",
    "side": "hands at most so far from the middle, on one side",
}


def reach(table: pd.DataFrame, path: Path) -> None:
    """Writes charts of the share of plans within reach and of the error against the size of a region, a row per region.

    Lines are means, with 95 % intervals, a line per way; dotted lines are the errors without limits and of no action.
    Columns of `table`: region (of REGIONS), size [m], way (of REACH), inside (share) and error [cloth length] and, with
    _low and _high, their intervals; error_free, error_no_action.
    """
    figure, axes = panels.chart(4, width=4.1, height=2.5, columns=2)
    titles = {"inside": "plans that stay inside [%]", "error": "error of the outcome\n[cloth length]"}
    for axis, (region, (column, title)) in zip(axes, product(REGIONS, titles.items()), strict=True):
        rows, scale = table[table["region"] == region], 100.0 if column == "inside" else 1.0
        for way, (label, colour, marker) in REACH.items():
            own = rows[rows["way"] == way].sort_values("size")
            mean, low, high = (scale * own[f"{column}{ending}"].to_numpy(float) for ending in ("", "_low", "_high"))
            axis.plot(own["size"], mean, f"{marker}-", color=colour, linewidth=1.2, markersize=4, label=label)
            axis.fill_between(own["size"], low, high, color=colour, alpha=0.13, linewidth=0)
        if column == "error":
            # Of plans within limits the errors lie between the two.
            for level, name, side in (("error_free", "no limit", "top"), ("error_no_action", "nothing done", "bottom")):
                axis.axhline(float(rows[level].mean()), color=panels.INK, linewidth=0.8, linestyle=(0, (1, 2)))
                at = (0.99, float(rows[level].mean()))
                axis.annotate(name, at, xycoords=axis.get_yaxis_transform(), fontsize=7, ha="right", va=side)
        axis.set_ylim(0, 105 if column == "inside" else 1.15 * max(rows["error_no_action"].max(), rows["error"].max()))
        axis.set_xticks(np.sort(rows["size"].unique()))
        axis.set_title(REGIONS[region], fontsize=8.5, color=panels.INK)
        axis.set_xlabel("size of the region [m]", fontsize=8)
        axis.set_ylabel(title, fontsize=8)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, frameon=False, loc="outside upper center", ncols=len(labels))
    panels.save(figure, path)
