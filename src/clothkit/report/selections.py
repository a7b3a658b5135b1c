"""The rows of a report's tables that its pages show, from those of the CSVs."""

import pandas as pd

from clothkit.report.entries import Report
from clothkit.report.formatting import TOO_FEW
from clothkit.report.layout import BY_LENGTH, LABELLED, PLAN_LENGTH, PLAN_WAYS, REACH, SPLITS, TASKS


def mark_systems(report: Report, rows: pd.DataFrame) -> pd.DataFrame:
    """The rows with a dagger at the systems whose budgets differ from that of main."""
    return rows.assign(system=rows["system"].map(report.marked))


def comparisons(report: Report, rows: pd.DataFrame) -> pd.DataFrame:
    """Comparisons, with a dagger where budgets are unequal and TOO_FEW in place of missing intervals and p."""
    if {"system", "against"} <= set(rows.columns):
        pairs = zip(rows["against"], rows["system"], strict=True)
        rows = rows.assign(against=[report.marked(*pair) for pair in pairs])
    few = {name: rows[name].astype(object).where(rows[name].notna(), TOO_FEW) for name in ("low", "high", "p")}
    return rows.assign(**few)


def comparisons_of_planners(report: Report, rows: pd.DataFrame) -> pd.DataFrame:
    """Those comparisons of the test set that are by length."""
    rows = rows[(rows["split"] == "test") & rows["column"].isin(BY_LENGTH)]
    return comparisons(report, rows.drop(columns="split"))


def of_test_set(report: Report, rows: pd.DataFrame) -> pd.DataFrame:
    """The rows of the test set, without the column of the split."""
    return rows[rows["split"] == "test"].drop(columns="split")


def means(report: Report, rows: pd.DataFrame) -> pd.DataFrame:
    """Mean errors on the test set: what (planning, prediction), system, source, then the columns of TASKS.

    The row of each planner is followed by the row of its labelled errors. Systems with other budgets have a dagger.
    """
    found = []
    for what, name in (("planning", "table_6"), ("prediction", "table_3")):
        table = report.contents.tables.get(
            name, pd.DataFrame(columns=["source", "split", "system", "statistic", *TASKS])
        )
        table = of_test_set(report, table)
        own, labelled = table[table["statistic"] == "mean"], table[table["statistic"] == LABELLED]
        for system in own.loc[own["source"] == "clothkit", "system"].drop_duplicates():
            found.append(own[own["system"] == system].assign(what=what))
            found.append(labelled[labelled["system"] == system].assign(what=what, system=f"{system}, labelled"))
    return mark_systems(report, pd.concat(found, ignore_index=True)[["what", "system", "source", *TASKS]])


def systems_of_means(report: Report) -> list[str]:
    """The systems in the table of `means`, as it names them, without those of labelled errors."""
    names = dict.fromkeys(means(report, pd.DataFrame())["system"])
    return [name for name in names if "labelled" not in name]


def budgets(report: Report, rows: pd.DataFrame) -> pd.DataFrame:
    """The table of budgets with parameters in millions."""
    spending = report.budgets
    table = spending.assign(parameters=spending["parameters"] / 1e6).rename(
        columns={"parameters": "parameters_millions"}
    )
    return table[["system", "source", *table.columns[2:]]]


def sigma_ratios(report: Report, rows: pd.DataFrame) -> pd.DataFrame:
    """The sigma ratios of main, by set."""
    return rows.drop(columns="system").assign(split=rows["split"].map(SPLITS))


def speed(report: Report, rows: pd.DataFrame) -> pd.DataFrame:
    """Table 8 with its columns in words."""
    named = {"1": "1 step", "2": "2 steps", "3": "3 steps", "estimate": "an estimate"}
    table = rows.astype({"machine": object}).fillna({"machine": ""}).rename(columns=named)
    return table[["system", "source", *table.columns[2:]]]


def plan_length(report: Report, rows: pd.DataFrame) -> pd.DataFrame:
    """Sessions of the test set whose number of manipulations was chosen, beside those with the recorded number."""
    rows = rows[(rows["split"] == "test") & rows["steps"].isin(["given", "chosen"])]
    order = {column: place for place, column in enumerate((*BY_LENGTH, "all"))}
    rows = rows[rows["column"].isin(order)].sort_values("column", key=lambda names: names.map(order), kind="stable")
    return rows[[name for name in PLAN_LENGTH if name != "split"]]


def margins(report: Report, rows: pd.DataFrame) -> pd.DataFrame:
    """The margins, and which was chosen in a word."""
    return rows.assign(chosen=rows["chosen"].map(lambda chosen: "yes" if chosen else "no"))


def plan_ways(report: Report, rows: pd.DataFrame) -> pd.DataFrame:
    """The comparisons by recorded length, with TOO_FEW in place of missing intervals and p."""
    return comparisons(report, rows.loc[rows["column"].isin(BY_LENGTH), list(PLAN_WAYS)])


def reach(report: Report, rows: pd.DataFrame) -> pd.DataFrame:
    """The columns of the table of reach."""
    return rows[list(REACH)]
