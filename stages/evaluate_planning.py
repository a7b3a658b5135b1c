"""Holds planners against one another, and looks for why plans fail: `python stages/evaluate_planning.py`."""

from pathlib import Path

from clothkit.dataset.rows import write_rows
from clothkit.evaluation import planning
from clothkit.stage import stage

PLANNING = Path("data/evaluation/planning")


def main() -> None:
    """Write comparisons.parquet, intervals.parquet and failures.parquet in data/evaluation/planning."""
    with stage("evaluate_planning") as s:
        work = s.work(inputs=[PLANNING / f"{system}.parquet" for system in s.params.systems])
        tidy = planning.read(PLANNING, s.params)
        found = {
            "comparisons": planning.comparisons(tidy),
            "intervals": planning.intervals(tidy),
            "failures": planning.failures(tidy),
        }
        for name, rows in found.items():
            write_rows(work / f"{name}.parquet", rows, s.attributes)
        for name in found:
            s.publish(work / f"{name}.parquet", PLANNING / f"{name}.parquet")


if __name__ == "__main__":
    main()
