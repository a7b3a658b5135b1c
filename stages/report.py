"""Writes the tables, figures and metrics of reports/<scale>/, which stage pages shows: `python stages/report.py`."""

import shutil
from pathlib import Path

from ruamel.yaml import YAML

from clothkit.report.build import build
from clothkit.report.inputs import paths, read
from clothkit.report.paper import without_paper
from clothkit.report.timings import table_8, timings
from clothkit.runtime.stage import stage

DATA, TIMINGS = Path("data"), Path(".work/timings")
OUTS = ("tables", "figures", "plots", "metrics.json", "metrics.csv", "params.yaml", "timings.csv", "table_8.csv")


def main() -> None:
    """Write the tables and figures of reports/<scale>/ and publish each part as a DVC out."""
    with stage("report") as s:
        members = s.shared.ensemble.members
        report = s.work(inputs=paths(DATA, members, s.params)) / "report"
        shutil.rmtree(report, ignore_errors=True)
        build(report, read(DATA, members, s.params), s.params)
        settings = s.shared.model_dump(mode="json")
        settings["scales"] = {s.shared.scale: settings["scales"][s.shared.scale]}
        YAML().dump(settings, report / "params.yaml")
        timings(TIMINGS).to_csv(report / "timings.csv", index=False, lineterminator="\n")
        speed = table_8(TIMINGS, s.params.planners)
        speed = speed if s.params.paper else without_paper(speed)
        speed.to_csv(report / "table_8.csv", index=False, float_format="%.5g", lineterminator="\n")
        for out in OUTS:
            s.publish(report / out, f"reports/{s.shared.scale}/{out}")


if __name__ == "__main__":
    main()
