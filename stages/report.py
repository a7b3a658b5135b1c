"""Writes tables, figures and the page that shows them, reports/<scale>/: `python stages/report.py`."""

import shutil
from pathlib import Path

from ruamel.yaml import YAML

from clothkit.report import page
from clothkit.report.build import build
from clothkit.report.html import page as html
from clothkit.report.inputs import paths, read
from clothkit.report.timings import table_8, timings, training
from clothkit.stage import stage

DATA, TIMINGS = Path("data"), Path(".work/timings")
OUTS = (
    "tables",
    "figures",
    "plots",
    "metrics.json",
    "metrics.csv",
    "README.md",
    "index.html",
    "params.yaml",
    "timings.csv",
    "table_8.csv",
    "table_8.md",
)


def main() -> None:
    """Write reports/<scale>/, each of its parts an out of its own."""
    with stage("report") as s:
        report = s.work(inputs=paths(DATA, s.params)) / "report"
        shutil.rmtree(report, ignore_errors=True)
        contents = build(report, read(DATA, s.params), s.params, scale=s.shared.scale)
        made_with = s.shared.model_dump(mode="json")
        made_with["scales"] = {s.shared.scale: made_with["scales"][s.shared.scale]}
        YAML().dump(made_with, report / "params.yaml")
        costs = timings(TIMINGS)
        costs.to_csv(report / "timings.csv", index=False, lineterminator="\n")
        speed = table_8(TIMINGS, s.params.planners)
        speed.to_csv(report / "table_8.csv", index=False, float_format="%.5g", lineterminator="\n")
        (report / "table_8.md").write_text(page.table_8(speed, training(costs)))
        run = html.Run((report / "params.yaml").read_text(), costs, speed)
        (report / "index.html").write_text(html.page(contents, report / "figures", run))
        for out in OUTS:
            s.publish(report / out, f"reports/{s.shared.scale}/{out}")


if __name__ == "__main__":
    main()
