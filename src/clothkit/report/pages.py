"""Writes the pages of a report, README.md and index.html, from its tables, and the table of budgets that both show."""

from pathlib import Path

from clothkit.report import contents, page
from clothkit.report.budgets import budgets
from clothkit.report.html import page as html
from clothkit.report.layout import NO_ACTION
from clothkit.report.sections import sections

INPUTS = ("params.yaml", "tables", "figures", "timings.csv", "table_8.csv", "studies/memory.csv")
"""Inputs of the pages in the report's folder; the last three may be missing."""

OUTS = ("README.md", "index.html", "budgets.csv")


def write(report: Path, folder: Path) -> None:
    """Writes OUTS into `folder` from INPUTS in `report`. Equal inputs give equal bytes.

    Raises InputError for a file that is missing or malformed. Tables that older reports lack may be missing.
    """
    shown = contents.read(report)
    own = shown.tables["table_6"].query("source == 'clothkit'")["system"].drop_duplicates()
    spending = budgets(shown.made_with, shown.tables.get("timings"), [name for name in own if name != NO_ACTION])
    spending.to_csv(folder / "budgets.csv", index=False, float_format="%.5g", lineterminator="\n")
    parts = sections(shown, spending)
    (folder / "README.md").write_text(page.page(shown.made_with.scale, parts))
    (folder / "index.html").write_text(html.page(shown, parts, report / "figures"))
