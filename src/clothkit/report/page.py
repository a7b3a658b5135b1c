"""The report as one Markdown page: the headline, every table and picture, and what it was made with."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from clothkit.report import captions, markdown
from clothkit.report.tables import TASKS


@dataclass(frozen=True)
class Contents:
    """What the page shows: tables as of `tables`, and the figures that were drawn, by name."""

    scale: str
    table_2: pd.DataFrame
    table_3: pd.DataFrame
    table_5: pd.DataFrame
    table_4: pd.DataFrame
    comparisons: pd.DataFrame
    table_6: pd.DataFrame
    table_7: pd.DataFrame
    planning_comparisons: pd.DataFrame
    failures: pd.DataFrame
    largest: pd.DataFrame
    camera_estimation: pd.DataFrame
    camera_planning: pd.DataFrame
    camera_comparisons: pd.DataFrame
    sigma_ratio: pd.DataFrame
    splits: pd.DataFrame
    attempts: pd.DataFrame
    tasks: Mapping[str, int]
    """Sequences that were planned for, by split."""
    canonical: str
    """What is told of the descriptions in which nets see cloths."""
    figures: Sequence[str]


KEYS = {
    "table_2": ("split", "kind", "statistic"),
    "table_3": ("split", "system", "statistic"),
    "table_5": ("split", "system", "statistic"),
    "table_4": ("split", "system", "statistic"),
    "table_6": ("split", "system", "statistic"),
    "table_7": ("split", "system", "statistic"),
    "sigma_ratio": ("split", "system"),
}
"""What tells the rows of a table apart, beside their source."""

BY_LENGTH = ("1/all", "2/all", "3/all")
"""Columns of the comparisons on the page."""


def page(contents: Contents) -> str:
    """The page as a Markdown string; it refers to the files that `build` puts beside it."""
    counts = " and ".join(f"{count} {split}" for split, count in contents.tasks.items())
    parts = [
        f"# Report: {contents.scale}\n",
        captions.INTRO,
        contents.canonical,
        f"Planned and executed: every task of {counts} sequences. {captions.PAPER}",
        "## Test set in short: mean errors\n",
        markdown.table(short(contents), ["what", "system"]),
        "## Planning\n",
        _figure(contents, "sessions_1"),
        _figure(contents, "sessions_2"),
        _figure(contents, "sessions_3"),
        _block("Table 6", "table_6", contents.table_6, captions.LABELLED + captions.INTERVALS),
        _figure(contents, "scatter"),
        _block("Table 7", "table_7", contents.table_7, captions.PLANNING_VOXELS),
        _compared(contents.planning_comparisons),
        "### Table 8\n",
        captions.SPEED,
        _block("Failures", "failures", contents.failures[contents.failures["split"] == "test"], captions.FAILURES),
        _block("Largest errors", "largest", contents.largest, captions.LARGEST),
        _figure(contents, "largest"),
        "## Prediction\n",
        _figure(contents, "predictions"),
        _block("Table 3", "table_3", contents.table_3),
        _block("Table 4", "table_4", contents.table_4, captions.VOXELS),
        captions.COMPARISONS,
        table("comparisons", contents.comparisons),
        _block("Table 5", "table_5", contents.table_5, captions.POSITION),
        "## Estimation\n",
        _figure(contents, "estimates"),
        _block("Table 2", "table_2", contents.table_2),
        "## Before a depth camera\n",
        captions.CAMERA,
        _block("Seen and estimated", "camera_estimation", contents.camera_estimation, captions.CAMERA_ESTIMATION),
        _figure(contents, "camera"),
        _block("Planned", "camera_planning", contents.camera_planning, captions.CAMERA_PLANNING),
        captions.CAMERA_COMPARISONS,
        table("camera_comparisons", contents.camera_comparisons),
        "## Stated and actual uncertainty\n",
        captions.UNCERTAINTY,
        table("sigma_ratio", contents.sigma_ratio),
        _figure(contents, "calibration"),
        "## Data and training\n",
        "[The dataset](dataset/README.md): files, columns, yield, quality, its worst states.\n",
        table("splits", contents.splits),
        _figure(contents, "sequences"),
        "Tried sequences, by what became of them:\n",
        table("attempts", contents.attempts),
        _figure(contents, "curves"),
        "## Representations\n",
        *(_figure(contents, name) for name in ("meshes", "voxels", "trajectories", "equivalents")),
        "## Made with\n",
        "[params.yaml](params.yaml), [metrics.json](metrics.json), [seconds and memory of every stage](timings.csv).\n",
    ]
    return "\n".join(part for part in parts if part)


def short(contents: Contents) -> pd.DataFrame:
    """Mean errors on the test set: what (planning, prediction), system, source, then the columns of TASKS."""
    rows = []
    for what, data in (("planning", contents.table_6), ("prediction", contents.table_3)):
        means = data[(data["split"] == "test") & (data["statistic"] == "mean")]
        own = means.loc[means["source"] == "clothkit", "system"].drop_duplicates()
        rows += [means[means["system"] == system].assign(what=what) for system in own]
    return pd.concat(rows)[["what", "system", "source", *TASKS]]


def _compared(comparisons: pd.DataFrame) -> str:
    shown = comparisons[(comparisons["split"] == "test") & comparisons["column"].isin(BY_LENGTH)]
    if shown.empty:
        return ""
    return _block(
        "Planners compared", "planning_comparisons", shown.drop(columns="split"), captions.PLANNING_COMPARISONS
    )


def table_8(data: pd.DataFrame, training: str) -> str:
    """The page of table 8 as a Markdown string, with what is told of the nets' training."""
    parts = ("# Table 8: seconds per plan\n", captions.SPEED_MEANS, table("table_8", data), training)
    return "\n".join(part for part in parts if part)


def table(name: str, data: pd.DataFrame) -> str:
    """A table of `Contents` as a Markdown string."""
    return markdown.table(data, KEYS[name]) if name in KEYS else markdown.plain(data)


def _block(title: str, name: str, data: pd.DataFrame, text: str = "") -> str:
    link = f"[CSV](tables/{name}.csv)"
    return "\n".join(part for part in (f"### {title}\n", text, f"{link}\n", table(name, data)) if part)


def _figure(contents: Contents, name: str) -> str:
    return f"![{name}](figures/{name}.png)\n\n*{captions.CAPTIONS[name]}*\n" if name in contents.figures else ""
