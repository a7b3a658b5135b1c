"""The report's sections in order, with their contents: one list, which the Markdown and the HTML page render."""

from collections.abc import Iterator
from dataclasses import dataclass

import pandas as pd

from clothkit.report import budgets, captions, findings, said
from clothkit.report.blocks import Block, Cards, Figure, Missing, Params, Section, Stages, Table, Text
from clothkit.report.budgets import DAGGER
from clothkit.report.contents import Contents
from clothkit.report.layout import BY_LENGTH, LABELLED, TASKS
from clothkit.report.printed import IDEAL_RATIO, TOO_FEW

SPLITS = {"test": "Test set", "train": "Training set"}

LENGTHS = "lengths of the cloth's side"
VOXELS = "mean voxel value difference"

PREDICTORS = {"a2": "b4", "main_occluded": "main"}
"""For systems of table 4, the planner that uses the same forward models."""


def sections(contents: Contents, spending: pd.DataFrame) -> list[Section]:
    """The sections of the pages. Contents that an older report lacks are left out or marked as missing.

    `spending` is the table of `budgets.budgets`.
    """
    page = _Page(contents, spending)
    return [
        Section("short", "In short", list(_short(page))),
        Section("planning", "Planning", list(_planning(page))),
        Section("prediction", "Prediction", list(_prediction(page))),
        Section("estimation", "Estimation", list(_estimation(page))),
        Section("camera", "Depth camera", list(_camera(page))),
        Section("uncertainty", "Uncertainty", list(_uncertainty(page))),
        Section("data", "Data and training", list(_data(page))),
        Section(
            "representations",
            "Representations",
            list(page.figures("meshes", "voxels", "trajectories", "equivalents")),
        ),
        Section("time", "Time", list(_time(page))),
        Section("params", "Made with", [Params()]),
    ]


@dataclass(frozen=True)
class _Page:
    contents: Contents
    spending: pd.DataFrame

    def figures(self, *names: str) -> Iterator[Figure]:
        """Those of the named figures that were drawn."""
        drawn = self.contents.figures
        return (Figure(name, drawn[name]) for name in names if name in drawn)

    def data(self, name: str) -> pd.DataFrame:
        """A table of the report by name; an empty table if the report lacks it."""
        return self.contents.tables.get(name, pd.DataFrame())

    def paired(self, name: str, title: str, *words: str, by: str = "system", **more: object) -> Block:
        """A table with the paper's figures beside ours; Missing if the report lacks it."""
        data = self.data(name)
        if data.empty:
            return Missing(title)
        if by == "system":
            data = data.assign(system=data["system"].map(self.marked))
        return Table(name, title, data, words, ("split", by, "statistic"), **more)  # type: ignore[arg-type]

    def plain(self, name: str, title: str, data: pd.DataFrame, *words: str) -> Iterator[Table]:
        """A table of our figures alone; nothing if it is empty."""
        if not data.empty:
            yield Table(name, title, data, words)

    def marked(self, system: str, against: str = "main") -> str:
        """The name of a system, with a dagger if its budget differs from that of `against`."""
        one, other = (PREDICTORS.get(name, name) for name in (system, against))
        return system + DAGGER * budgets.differ(self.spending, one, other)

    def compared(self, data: pd.DataFrame) -> pd.DataFrame:
        """Comparisons, with a dagger where budgets are unequal and TOO_FEW in place of missing intervals and p."""
        if {"system", "against"} <= set(data.columns):
            pairs = zip(data["against"], data["system"], strict=True)
            data = data.assign(against=[self.marked(*pair) for pair in pairs])
        few = {name: data[name].astype(object).where(data[name].notna(), TOO_FEW) for name in ("low", "high", "p")}
        return data.assign(**few)


def _short(page: _Page) -> Iterator[Block]:
    contents, compared = page.contents, page.data("planning_comparisons")
    if not compared.empty:
        yield from map(Text, findings.findings(compared))
    yield Text(said.planned(contents))
    yield Cards()
    table = short(contents)
    own = [name for name in dict.fromkeys(table["system"]) if "labelled" not in name]
    marked = table.assign(system=table["system"].map(page.marked))
    yield Table(
        "means",
        "Mean errors on the test set",
        marked,
        (captions.LABELLED_SHORT, said.replay(contents), _dagger(page)),
        ("what", "system"),
        judged=[page.marked(name) for name in own],
        unit=LENGTHS,
        file="tables/table_6.csv",
    )
    yield Text(captions.INTRO)
    yield Text(said.descriptions(contents))


def short(contents: Contents) -> pd.DataFrame:
    """Mean errors on the test set: what (planning, prediction), system, source, then the columns of TASKS.

    The row of each planner is followed by the row of its labelled errors.
    """
    rows = []
    for what, name in (("planning", "table_6"), ("prediction", "table_3")):
        data = contents.tables.get(name, pd.DataFrame(columns=["source", "split", "system", "statistic", *TASKS]))
        data = data[data["split"] == "test"]
        means, labelled = data[data["statistic"] == "mean"], data[data["statistic"] == LABELLED]
        for system in means.loc[means["source"] == "clothkit", "system"].drop_duplicates():
            rows.append(means[means["system"] == system].assign(what=what))
            rows.append(labelled[labelled["system"] == system].assign(what=what, system=f"{system}, labelled"))
    return pd.concat(rows, ignore_index=True)[["what", "system", "source", *TASKS]]


def _dagger(page: _Page) -> str:
    systems = set(page.data("table_6").get("system", []))
    return said.unequal(page.spending) if any(page.marked(system) != system for system in systems) else ""


def _planning(page: _Page) -> Iterator[Block]:
    yield from page.figures("sessions_1", "sessions_2", "sessions_3")
    yield page.paired(
        "table_6",
        "Table 6: planning, in meshes",
        captions.LABELLED,
        captions.INTERVALS,
        _dagger(page),
        unit=LENGTHS,
    )
    yield from page.figures("scatter")
    words: tuple[str, ...] = (
        captions.PLANNING_VOXELS,
        said.viewport(page.contents, "table_7", "table_6"),
        _dagger(page),
    )
    yield page.paired("table_7", "Table 7: planning, in voxels", *words, unit=VOXELS)
    words = (captions.TALL.format(""), _dagger(page))
    yield page.paired("table_7_025", "Table 7 for a viewport of height 0.25", *words, unit=VOXELS)
    yield Table("budgets", "Budgets", _in_millions(page.spending), (captions.BUDGETS,), file="budgets.csv")
    compared = page.data("planning_comparisons")
    if not compared.empty:
        compared = compared[(compared["split"] == "test") & compared["column"].isin(BY_LENGTH)].drop(columns="split")
        words = (captions.PLANNING_COMPARISONS, _dagger(page))
        yield from page.plain("planning_comparisons", "Planners compared", page.compared(compared), *words)
    failures = page.data("failures")
    if not failures.empty:
        failures = failures[failures["split"] == "test"].drop(columns="split")
    yield from page.plain("failures", "Failures", failures, captions.FAILURES)
    yield from page.plain("largest", "Largest errors", page.data("largest"), captions.LARGEST)
    yield from page.figures("largest")


def _in_millions(spending: pd.DataFrame) -> pd.DataFrame:
    counts = spending["parameters"] / 1e6
    table = spending.assign(parameters=counts).rename(columns={"parameters": "parameters_millions"})
    return table[["system", "source", *table.columns[2:]]]


def _prediction(page: _Page) -> Iterator[Block]:
    yield from page.figures("predictions")
    yield page.paired("table_3", "Table 3: predicted meshes", unit=LENGTHS)
    dagger = said.unequal_nets(page.spending) if page.marked("a2") != "a2" else ""
    words: tuple[str, ...] = (captions.VOXELS, said.viewport(page.contents, "table_4", "table_3"), dagger)
    yield page.paired("table_4", "Table 4: predicted meshes, in voxels", *words, unit=VOXELS)
    words = (captions.TALL.format(captions.TALL_A2), dagger)
    yield page.paired("table_4_025", "Table 4 for a viewport of height 0.25", *words, unit=VOXELS)
    compared = page.data("comparisons")
    if not compared.empty:
        words = (captions.COMPARISONS, dagger)
        yield from page.plain("comparisons", "Predictors compared", page.compared(compared), *words)
    heads = {"1": "1 manipulation", "2": "2 manipulations", "3": "3 manipulations"}
    yield page.paired("table_5", "Table 5: predicted position", captions.POSITION, unit=LENGTHS, heads=heads)


def _estimation(page: _Page) -> Iterator[Block]:
    yield from page.figures("estimates")
    heads = {"1": "after 1", "2": "after 2", "3": "after 3"}
    title = "Table 2: estimated meshes"
    yield page.paired("table_2", title, captions.STATES, by="kind", unit=LENGTHS, heads=heads)


def _camera(page: _Page) -> Iterator[Block]:
    yield Text(captions.CAMERA)
    seen, planned, compared = (page.data(f"camera_{name}") for name in ("estimation", "planning", "comparisons"))
    yield from page.plain("camera_estimation", "Seen and estimated", seen, captions.CAMERA_ESTIMATION)
    yield from page.figures("camera")
    yield from page.plain("camera_planning", "Planned", planned, captions.CAMERA_PLANNING)
    if not compared.empty:
        words = captions.CAMERA_COMPARISONS
        yield from page.plain("camera_comparisons", "Conditions compared", page.compared(compared), words)


def _uncertainty(page: _Page) -> Iterator[Block]:
    ratios = page.data("sigma_ratio")
    if not ratios.empty:
        ratios = ratios.drop(columns="system").assign(split=ratios["split"].map(SPLITS))
        yield Table(
            "sigma_ratio",
            "Stated and actual uncertainty",
            ratios,
            (captions.UNCERTAINTY,),
            ("split",),
            judged=list(SPLITS.values()),
            ideal=IDEAL_RATIO,
            heads={"1": "prediction, 1", "2": "prediction, 2", "3": "prediction, 3"},
        )
    yield from page.figures("calibration")


def _data(page: _Page) -> Iterator[Block]:
    splits, attempts = page.data("splits"), page.data("attempts")
    if not splits.empty and not attempts.empty:
        yield from page.plain("splits", "The dataset", splits, _summary(splits, attempts))
        yield from page.plain("attempts", "Tried sequences", attempts, "By what became of them.\n")
    yield from page.figures("sequences", "curves")


def _summary(splits: pd.DataFrame, attempts: pd.DataFrame) -> str:
    count, manipulations = int(splits["sequences"].sum()), int(splits["manipulations"].sum())
    single = float((splits["single_handed"] * splits["manipulations"]).sum()) / max(manipulations, 1)
    accepted = float(attempts.loc[attempts["outcome"] == "accepted", "share"].sum())
    return (
        f"{count} sequences of a square cloth folded at random, {manipulations} manipulations, {100 * single:.1f} % of "
        f"them single-handed; {100 * accepted:.1f} % of the tried sequences were accepted. [The dataset's card]"
        "(dataset/README.md) tells its files, columns, quality and worst states.\n"
    )


def _time(page: _Page) -> Iterator[Block]:
    seconds = page.data("table_8")
    if not seconds.empty:
        named = {"1": "1 step", "2": "2 steps", "3": "3 steps", "estimate": "an estimate"}
        told = seconds.fillna({"machine": ""}).rename(columns=named)
        told = told[["system", "source", *told.columns[2:]]]
        yield Table("table_8", "Table 8: seconds per plan", told, (captions.SPEED,), file="table_8.csv")
    yield Stages(page.data("timings"))
