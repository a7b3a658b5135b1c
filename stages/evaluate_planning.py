"""Compares the planners and determines why plans fail: `python stages/evaluate_planning.py`."""

from pathlib import Path

import pandas as pd

from clothkit.dataset.rows import write_rows
from clothkit.episodes import record
from clothkit.evaluation import planning, viewport
from clothkit.runtime.stage import stage

PLANNING = Path("data/evaluation/planning")


def main() -> None:
    """Write comparisons, intervals, failures and voxels_025.parquet in data/evaluation/planning."""
    with stage("evaluate_planning") as s:
        sessions = {system: PLANNING / f"sessions_{system}.zarr" for system in s.params.systems}
        work = s.work(inputs=[*(PLANNING / f"{system}.parquet" for system in sessions), *sessions.values()])
        tidy = planning.read(PLANNING, s.params)
        tall = pd.concat([viewport.rows(record.load(path), system) for system, path in sessions.items()])
        found = {
            "comparisons": planning.comparisons(tidy),
            "intervals": planning.intervals(tidy.merge(tall, how="left", validate="one_to_one")),
            "failures": planning.failures(tidy),
            "voxels_025": tall,
        }
        for name, rows in found.items():
            write_rows(work / f"{name}.parquet", rows, s.attributes)
        for name in found:
            s.publish(work / f"{name}.parquet", PLANNING / f"{name}.parquet")


if __name__ == "__main__":
    main()
