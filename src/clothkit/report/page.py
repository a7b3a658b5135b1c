"""The report as one Markdown page: the headline, every table and picture, and what it was made with."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from clothkit.report import markdown
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
    sigma_ratio: pd.DataFrame
    attempts: pd.DataFrame
    tasks: Mapping[str, int]
    """Sequences that were planned for, by split."""
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

_SESSIONS = (
    "Above the recorded sequence and its goal (light blue), which is all that the planner is given of it; at the left "
    "what happened, the outcome in light blue; between, plan by plan, the estimate (E) with grasp candidates (lilac "
    "circles) and the predictions (P, σ lilac); at the right the predicted outcome, refined."
)
_VOXELS = (
    "The same predictions in voxels: mean absolute difference of voxel values. *a2* is the paper's voxel baseline, "
    "which sees, and predicts, voxels. Meshes become voxels by eq. (16), and their truth is unoccluded, a vertex per "
    "grid point. *a2* predicts what a camera above sees, and its truth is that: occluded, at twice the mesh's "
    "resolution; so is its *no action*.\n"
)
_COMPARISONS = (
    "The two on the same tasks: mean difference (system minus the one it is held against: below zero the first is "
    "better), its 95 % bootstrap interval, and p of a two-sided paired sign-flip test, both over sequences. [CSV]"
    "(tables/comparisons.csv)\n"
)
_POSITION = (
    "The predicted shift of the cloth's centre, by the number of manipulations, from every start; *no action* "
    "predicts no shift.\n"
)
_INTERVALS = (
    "*mean 95 % low* and *high* are the ends of a bootstrap interval of our mean, drawn by sequences, since tasks of "
    "one sequence share its states.\n"
)
_PLANNING_VOXELS = (
    "The same outcomes and goals in voxels: mean absolute difference of voxel values, both sides free of noise and "
    "unoccluded, a vertex per grid point. It is the format in which *b4* and *b5* plan.\n"
)
_PLANNING_COMPARISONS = (
    "Two planners on the same tasks: mean difference (system minus the one it is held against: below zero the first is "
    "better), its 95 % bootstrap interval, and p of a two-sided paired sign-flip test, both over sequences; p is not "
    "adjusted for the number of comparisons. Shown are those of the test set by length; the CSV has every start, and "
    "the training set.\n"
)
_SPEED = (
    "Seconds of search per plan, by system and plan length, beside the paper's: [table 8](table_8.md) ([CSV]"
    "(table_8.csv)), on a page of its own, since no two runs take the same time.\n"
)
_FAILURES = (
    "Of each session's first plan, test set. *search_failure*: share of plans that the nets rate worse than the "
    "recorded manipulations, which the search missed; *model_failure*: share that they rate no worse, yet whose "
    "outcome is more than 0.05 off; *grasp_offered*: share of starts with a grasp candidate at each recorded grasp "
    "point; *nulls_fired*: manipulations per session that the planner cancelled because it expected them to lead away "
    "from the goal, *nulls_helped*: the share of these that would have done so in simulation; *expected*, *error*: "
    "mean error that the nets expect, and that came; *error_estimate_good*, *error_estimate_bad*: mean error of tasks "
    "whose first estimate is within 0.05 of the truth, and of the others. The CSV has the training set, too.\n"
)
_LARGEST = (
    "The test tasks with the largest errors, and why, in the words of the paper's section 6.4; the first that holds: a "
    "recorded grasp point had no candidate nearby (*grasp point not offered*); the first estimate was more than 0.05 "
    "off (*estimate wrong*); the nets rate the recorded manipulations better than the plan (*search failure*); they "
    "expected an error of at most 0.05 (*model failure*); none of these (*open*): they knew that the plan is not good, "
    "and think no better of the recorded manipulations. All of the first plan: what went wrong later is not told.\n"
)
CAPTIONS = {
    "sequences": "Simulated test sequences: states from above, manipulations dotted (red and green: the two hands); "
    "blue and orange are the cloth's two sides.",
    "estimates": "Estimates of test sequences after one, two and three manipulations: truth, voxels, VtM's mean with "
    "its σ in lilac, and the refined mesh.",
    "predictions": "Predictions from an estimate of the first state (E) beside what was recorded (R). Lilac is σ, the "
    "yellow line the predicted shift of the cloth's centre.",
    "sessions_1": f"Planning in one step. {_SESSIONS}",
    "sessions_2": f"Planning in two steps. {_SESSIONS}",
    "sessions_3": f"Planning in three steps. {_SESSIONS}",
    "calibration": "Test set: the share of coordinates whose error is below z σ, against the share of a normal "
    "distribution there; dots are at z = 1. Above the dashed diagonal σ is larger than the errors warrant, below it "
    "smaller. Estimates by the manipulations that lie behind the state; predictions from estimates, by the "
    "manipulations predicted, from every start.",
    "scatter": "Planning error against prediction error, a dot per test task. Predictions start from what the planner "
    "starts from: estimates beside main, true meshes (a1) beside b1.",
    "largest": "The largest errors, in the table's order: start with the recorded manipulation; goal; estimate with "
    "grasp candidates (lilac circles) and the first manipulation of the first plan; the outcome that is predicted "
    "for it (σ lilac); the session's real outcome. Numbers are how far the estimate is off, how far from the goal the "
    "nets expect to end, and how far from it the cloth was in the end.",
    "curves": "Validation errors during training, with their values where the score was best (dots). Tasks: "
    "manipulations / state that they start from; states: manipulations that lie behind them.",
}


def page(contents: Contents) -> str:
    """The page as a Markdown string; it refers to the files that `build` puts beside it."""
    counts = " and ".join(f"{count} {split}" for split, count in contents.tasks.items())
    parts = [
        f"# Report: {contents.scale}\n",
        "Errors are mean distances between vertices in lengths of the cloth's side, the smallest over the cloth's "
        "eight equivalent labellings; outcomes and *no action* (start against goal) are moved onto the goal first, "
        "estimates and predictions are not. Columns: manipulations / state that they start from. *main* sees voxels "
        "only; *a1* predicts, and *b1* plans, from true meshes; *b2* plans with one net, *b3* without the uncertainty "
        "term, *b4* and *b5* in voxels, with two nets and with one. Pictured are the first test sequences, not chosen "
        "ones, but for the largest errors.\n",
        f"Planned and executed: every task of {counts} sequences. The paper's figures are from another simulator, "
        "3,493 training sequences, and 100 test and 100 training sequences in each table.\n",
        "## Test set in short: mean errors\n",
        _headline(contents),
        "## Planning\n",
        _figure(contents, "sessions_1"),
        _figure(contents, "sessions_2"),
        _figure(contents, "sessions_3"),
        _block("Table 6", "table_6", contents.table_6, _INTERVALS),
        _figure(contents, "scatter"),
        _block("Table 7", "table_7", contents.table_7, _PLANNING_VOXELS),
        _compared(contents.planning_comparisons),
        "### Table 8\n",
        _SPEED,
        _block("Failures", "failures", contents.failures[contents.failures["split"] == "test"], _FAILURES),
        _block("Largest errors", "largest", contents.largest, _LARGEST),
        _figure(contents, "largest"),
        "## Prediction\n",
        _figure(contents, "predictions"),
        _block("Table 3", "table_3", contents.table_3),
        _block("Table 4", "table_4", contents.table_4, _VOXELS),
        _COMPARISONS,
        table("comparisons", contents.comparisons),
        _block("Table 5", "table_5", contents.table_5, _POSITION),
        "## Estimation\n",
        _figure(contents, "estimates"),
        _block("Table 2", "table_2", contents.table_2),
        "## Stated and actual uncertainty\n",
        "Median over meshes of the mean of abs(error) / σ; 0.798 is ideal, less says that σ is too large. Columns: "
        "estimates, then predictions after one, two and three manipulations; the paper tells those of the test set.\n",
        table("sigma_ratio", contents.sigma_ratio),
        _figure(contents, "calibration"),
        "## Data and training\n",
        "[The dataset](dataset/README.md): files, columns, yield, quality, its worst states.\n",
        _figure(contents, "sequences"),
        "Tried sequences, by what became of them:\n",
        table("attempts", contents.attempts),
        _figure(contents, "curves"),
        "## Made with\n",
        "[params.yaml](params.yaml), [metrics.json](metrics.json), [seconds and memory of every stage](timings.csv).\n",
    ]
    return "\n".join(part for part in parts if part)


def _headline(contents: Contents) -> str:
    rows = []
    for what, data in (("planning", contents.table_6), ("prediction", contents.table_3)):
        means = data[(data["split"] == "test") & (data["statistic"] == "mean")]
        own = means.loc[means["source"] == "clothkit", "system"].drop_duplicates()
        rows += [means[means["system"] == system].assign(what=what) for system in own]
    return markdown.table(pd.concat(rows)[["what", "system", "source", *TASKS]], ["what", "system"])


def _compared(comparisons: pd.DataFrame) -> str:
    shown = comparisons[(comparisons["split"] == "test") & comparisons["column"].isin(BY_LENGTH)]
    if shown.empty:
        return ""
    return _block("Planners compared", "planning_comparisons", shown.drop(columns="split"), _PLANNING_COMPARISONS)


def table_8(data: pd.DataFrame) -> str:
    """The page of table 8 as a Markdown string."""
    return (
        "# Table 8: seconds per plan\n\n"
        "Seconds of search over the number of plans, by system and plan length; *estimate*: seconds per estimate of a "
        "mesh, refined. Searches run many at a time. A dash: none, or the stage's results were restored and its times "
        f"are not known.\n\n{table('table_8', data)}"
    )


def table(name: str, data: pd.DataFrame) -> str:
    """A table of `Contents` as a Markdown string."""
    return markdown.table(data, KEYS[name]) if name in KEYS else markdown.plain(data)


def _block(title: str, name: str, data: pd.DataFrame, text: str = "") -> str:
    link = f"[CSV](tables/{name}.csv)"
    return "\n".join(part for part in (f"### {title}\n", text, f"{link}\n", table(name, data)) if part)


def _figure(contents: Contents, name: str) -> str:
    return f"![{name}](figures/{name}.png)\n\n*{CAPTIONS[name]}*\n" if name in contents.figures else ""
