"""Writes the pages that show a report's tables and figures, reports/<scale>/: `python stages/pages.py`."""

from pathlib import Path

from clothkit.report import pages
from clothkit.runtime.stage import stage


def main() -> None:
    """Write README.md, index.html and budgets.csv from the report stage's outputs, which may come from git."""
    with stage("pages") as s:
        report = Path("reports") / s.shared.scale
        work = s.work(inputs=[report / name for name in pages.INPUTS if (report / name).exists()])
        pages.write(report, work)
        for out in pages.OUTS:
            s.publish(work / out, report / out)


if __name__ == "__main__":
    main()
