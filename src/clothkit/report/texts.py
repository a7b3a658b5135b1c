"""Texts of the report that depend on its settings or its figures, in Markdown; an empty one is left out."""

import math
from collections.abc import Callable

import pandas as pd

from clothkit.report import budgets, captions, findings, paper
from clothkit.report.contents import Contents
from clothkit.report.entries import Report
from clothkit.report.formatting import number
from clothkit.report.layout import BY_LENGTH


def with_paper(text: str, about_paper: str) -> Callable[[Report], str]:
    """A text that goes on about the paper where the paper's figures are in the report."""

    def words(report: Report) -> str:
        return f"{text.rstrip()} {about_paper}" if report.contents.settings.beside_paper else text

    return words


def is_beside_paper(report: Report) -> bool:
    """Whether the paper's figures are in the report, and with them the tables in the paper's voxels."""
    return report.contents.settings.beside_paper


def findings_on_planners(report: Report) -> list[str]:
    """What the comparisons of planners say, a paragraph each."""
    compared, beside_paper = report.table("planning_comparisons"), report.contents.settings.beside_paper
    return [] if compared.empty else findings.findings(compared, report.contents.doubt, beside_paper=beside_paper)


def planned(report: Report) -> str:
    """The sentence on the number of sequences in our planning tables and in the paper's."""
    counts = " and ".join(f"{count} {split}" for split, count in report.contents.planned.items())
    told = f"This report planned and executed every task of {counts} sequences."
    return f"{told} {captions.PAPER}" if report.contents.settings.beside_paper else f"{told}\n"


def intro(report: Report) -> str:
    """How errors and columns are meant, and the systems that the report has."""
    there = {system for name in ("table_3", "table_6") for system in report.table(name).get("system", [])}
    sentences: list[str] = []
    told: set[str] = set()
    for systems, sentence in captions.INTRODUCED.items():
        if there.issuperset(systems) and told.isdisjoint(systems):
            sentences.append(sentence)
            told |= set(systems)
    labellings = captions.LABELLINGS_VARIED if report.contents.settings.varied else captions.LABELLINGS
    return captions.INTRO.format(labellings=labellings, systems=" ".join(sentences))


def replay(report: Report) -> str:
    """Why one-step plans from the flat cloth have a small error; "" where each start is another, or not simulated."""
    error = mean(report.table("table_6"), "clothkit", "main", "1/0")
    settings = report.contents.settings
    if not settings.simulated or settings.varied or math.isnan(error):
        return ""
    return (
        f"A one-step plan from the flat cloth (state 0; *main*: {number(error)}) can be a replay: the simulator is "
        "deterministic and each sequence begins with the same flat cloth, so a plan that finds the recorded "
        "manipulation again reaches almost the recorded state. Its error shows that the search finds the manipulation, "
        "not how well the plan would work on a cloth that behaves a little differently.\n"
    )


def descriptions(report: Report) -> str:
    """How canonical nets describe cloths, and how they use the memory trace; "" if mesh nets are not canonical."""
    settings = report.contents.settings
    if not settings.canonical:
        return ""
    voxels = captions.VOXELS_CANONICAL if settings.voxels_canonical else captions.VOXELS_AS_THEY_ARE
    nets = captions.CANONICAL if settings.emd_voxel is None else f"{captions.CANONICAL}; {voxels}"
    return f"{nets}. {captions.MEMORY}{_memory(report.contents)}"


def _memory(contents: Contents) -> str:
    """The effect of carrying on the memory trace, as measured by its study."""
    study = contents.memory
    carried = None if study is None else study[study["system"] == "carried"]
    if carried is None or carried.empty:
        return captions.MEMORY_UNKNOWN
    difference = carried["difference"]
    return captions.MEMORY_STUDY.format(
        sequences=int(carried["sequences"].min()), low=difference.min(), high=difference.max(), p=carried["p"].max()
    )


def viewport_of_planning(report: Report) -> str:
    """`viewport` of table 7."""
    return viewport(report.contents, "table_7", "table_6")


def viewport_of_prediction(report: Report) -> str:
    """`viewport` of table 4."""
    return viewport(report.contents, "table_4", "table_3")


def viewport(contents: Contents, name: str, in_meshes: str) -> str:
    """How a table of voxel differences compares with the paper's, and the known reasons.

    `in_meshes` names the table with the errors of the same meshes.
    """
    to_no_action = "*mean / no action* compares our errors with those without any action.\n"
    if not contents.settings.beside_paper:
        return to_no_action
    voxels, meshes = (contents.tables.get(table, pd.DataFrame()) for table in (name, in_meshes))
    comparisons = []
    for system in () if voxels.empty else voxels.loc[voxels["source"] == "paper", "system"].drop_duplicates():
        times, errors = _times(voxels, system), "" if meshes.empty else _times(meshes, system)
        if times:
            also = f" ({errors} in {in_meshes.replace('_', ' ')})" if errors else ""
            comparisons.append(f"those of *{system}* are {times} the paper's{also}")
    where = f"Of our means by length, {', '.join(comparisons)}. " if comparisons else ""
    table_6, table_7 = paper.table(6), paper.table(7)
    pairs = " and ".join(
        f"*{system}*'s {length} from state {start} ({number(mean(table_6, 'paper', system, column))} in its table 6, "
        f"{number(mean(table_7, 'paper', system, column))} in its table 7)"
        for system, column, length, start in (("main", "2/1", "two steps", 1), ("b4", "1/2", "one step", 2))
    )
    return (
        f"{where}Two things are known about this difference. First, the paper's viewport and resolution make voxels "
        "eight times finer in z than in x and y, although its text says four, and fewer voxels agree if they are "
        "finer; the next table, for a viewport of height 0.25, has voxels that are four times finer. Second, the "
        "paper's table 7 is not consistent with its table 6 across systems: almost equal errors of meshes are voxel "
        f"differences that differ by more than a factor of two, in {pairs}. {to_no_action}"
    )


def _times(table: pd.DataFrame, system: str) -> str:
    """The ratio of our means to the paper's in words, from the least to the largest over all lengths."""
    pairs = [(mean(table, "clothkit", system, column), mean(table, "paper", system, column)) for column in BY_LENGTH]
    found = [own / other for own, other in pairs if not math.isnan(own / other)]
    return f"{min(found):.2f} to {max(found):.2f} times" if found else ""


def estimates_by_state(report: Report) -> str:
    """What the sigma ratios by state are; "" in older reports, which have none."""
    return captions.UNCERTAINTY_STATES if "estimate 1" in report.table("sigma_ratio") else ""


def unequal_budgets(report: Report) -> str:
    """What the dagger means in tables of planners; "" if no planner has one."""
    systems = set(report.table("table_6").get("system", []))
    if all(report.marked(system) == system for system in systems):
        return ""
    return _dagger(budgets.difference(report.budgets))


def unequal_training(report: Report) -> str:
    """What the dagger means in tables of predictions; "" if a2 has none."""
    if report.marked("a2") == "a2":
        return ""
    return _dagger(budgets.difference_of_training(report.budgets, "*a2* predicts with the nets of *b4*, which"))


def _dagger(difference: str) -> str:
    return f"†: has a different budget. {difference} ([budgets](#budgets)).\n" if difference else ""


def dataset(report: Report) -> str:
    """The counts of the dataset, and a link to its card."""
    splits, attempts = report.table("splits"), report.table("attempts")
    count, manipulations = int(splits["sequences"].sum()), int(splits["manipulations"].sum())
    single = float((splits["single_handed"] * splits["manipulations"]).sum()) / max(manipulations, 1)
    accepted = float(attempts.loc[attempts["outcome"] == "accepted", "share"].sum())
    cloths = "cloths of many kinds" if report.contents.settings.varied else "a square cloth"
    return (
        f"{count} sequences of {cloths} folded at random, {manipulations} manipulations, {100 * single:.1f} % of "
        f"them single-handed; {100 * accepted:.1f} % of the tried sequences were accepted. [The dataset's card]"
        "(dataset/README.md) describes its files, columns, quality and worst states.\n"
    )


def mean(table: pd.DataFrame, source: str, system: str, column: str) -> float:
    """A mean of the test set from a table; NaN if the table lacks it."""
    rows = table[(table["source"] == source) & (table["split"] == "test") & (table["statistic"] == "mean")]
    found = rows.loc[rows["system"] == system, column]
    return float(found.iloc[0]) if len(found) else math.nan
