"""Writes the pages of a report, README.md and index.html, from its tables, and the table of budgets that both show."""

from pathlib import Path

from clothkit.report import contents
from clothkit.report.budgets import budgets
from clothkit.report.contents import Contents
from clothkit.report.html import page as html
from clothkit.report.layout import NO_ACTION
from clothkit.report.markdown import page as markdown
from clothkit.report.paper import without_paper
from clothkit.report.sections import CAPTIONS, DRAWN, TABLES, sections

STUDIES = (
    *("studies/memory.csv", "studies/doubt_test_comparisons.csv"),
    *(path for path in TABLES if path.startswith("studies/")),
    *DRAWN,
)
"""Tables and pictures of studies that the pages quote or show, if there are any."""

INPUTS = ("params.yaml", "tables", "figures", "timings.csv", "table_8.csv", *STUDIES)
"""Inputs of the pages in the report's folder; those after the figures may be missing."""

OUTS = ("README.md", "index.html", "budgets.csv")


def write(report: Path, folder: Path) -> None:
    """Writes OUTS into `folder` from INPUTS in `report`. Equal inputs give equal bytes.

    Raises InputError for a file that is missing or malformed. Tables that older reports lack may be missing.
    """
    shown = read(report)
    own = shown.tables["table_6"].query("source == 'clothkit'")["system"].drop_duplicates()
    systems = [name for name in own if name != NO_ACTION]
    table = budgets(shown.settings, shown.tables.get("timings"), systems)
    if not shown.settings.beside_paper:
        table = without_paper(table)
    table.to_csv(folder / "budgets.csv", index=False, float_format="%.5g", lineterminator="\n")
    parts, title = sections(shown, table), f"Report: {shown.settings.scale}"
    (folder / "README.md").write_text(markdown.page(title, parts))
    (folder / "index.html").write_text(html.page(title, parts, report))


def read(report: Path) -> Contents:
    """The contents of reports/<scale>/. Raises InputError, as `contents.read`."""
    return contents.read(report, TABLES, CAPTIONS, DRAWN)
