"""How many hours would scale `paper` take on a device?  python benchmarks/paper_hours.py FOLDER .. [options]

Each FOLDER holds rows of benchmarks at scale `paper`: training.csv (training.py), planning.csv, planning_voxels.csv and
estimates.csv (planning.py). Where several have a row for the same, that of the last one counts. What a row costs is
multiplied by how often scale `paper` of params.yaml does it: iterations by nets, searches by the plan lengths of all
tasks, estimates. Costs are taken to be proportional to the number of strains. `--simulation CSV` has rows of
`simulation.py steps`, whose CPU seconds of a manipulation `--cores N` (default: those of this machine) divide.

Counted as their upper limits: VtM's iterations, which may end early; plans of b3, whose loss has a term less than that
of main; estimates of `unrefined`. Not counted: attempts that the simulator rejects, validations, evaluations other than
plans, and reports. A part without rows has no hours and is not in the sum. `--csv FOLDER` writes the table.
"""

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import pandas as pd
from tables import show

from clothkit.dataset.store import STEPS
from clothkit.dataset.tasks import TASKS
from clothkit.params import load_params
from clothkit.planning.systems import SYSTEMS
from clothkit.simulation.processes import cores

SEARCHES = {n: sum(length >= n for _, length in TASKS) for n in range(1, STEPS + 1)}
"""Searches of the sessions of a sequence's tasks, by the number of manipulations that are left."""

MEASURED = {"b1": "main", "b3": "main", "unrefined": "main"}
"""Systems whose searches are those of another one, which the rows have."""


@dataclasses.dataclass
class Part:
    """Something that the chain does often."""

    name: str
    number: int
    seconds: float | None
    """Of each; None: there is no row of it."""
    device: str = ""
    at_once: int = 1

    def row(self) -> dict:
        """Return the part's row of the table."""
        hours = None if self.seconds is None else self.number * self.seconds / self.at_once / 3600
        return {
            "part": self.name,
            "device": self.device or "not told",
            "number": self.number,
            "s each": self.seconds,
            "hours": None if hours is None else float(f"{hours:.3g}"),
        }


def read(folders: list[Path]) -> dict[str, pd.DataFrame]:
    """Return the rows of all folders by the name of their file; later ones first, and no kind of row twice."""
    found: dict[str, pd.DataFrame] = {}
    for folder in folders:
        for path in sorted(folder.glob("*.csv")):
            name = "planning" if path.stem == "planning_voxels" else path.stem
            rows = pd.read_csv(path)
            found[name] = pd.concat([rows, found[name]]) if name in found else rows
    return found


def costing(rows: pd.DataFrame | None, column: str, **wanted: Any) -> tuple[float | None, pd.Series]:
    """Return a column of the first row with the wanted values, in s, and the row; None and no row if there is none."""
    if rows is None or column not in rows:
        return None, pd.Series(dtype=object)
    for name, value in wanted.items():
        rows = rows[rows[name] == value]
    if not len(rows):
        return None, pd.Series(dtype=object)
    return float(rows[column].iloc[0]), rows.iloc[0]


def device_of(row: pd.Series) -> str:
    """Return the name of the device that a row was measured on, empty if it does not tell."""
    told = row.get("device", "")
    return told if isinstance(told, str) else ""


def training(stages: Any, members: int, found: dict[str, pd.DataFrame]) -> list[Part]:
    """Return the trainings. There are no rows for voxel nets, which benchmarks/training.py does not train."""
    parts = []
    for net, count in (("pemd", members), ("vtm", 1), ("emd_voxel", members)):
        settings = getattr(stages, f"train_{net}").training
        milliseconds, row = costing(found.get("training"), "step ms", net=net)
        seconds = None if milliseconds is None else milliseconds / 1e3
        parts.append(Part(f"train {net}, iterations", count * settings.iterations, seconds, device_of(row)))
    return parts


def planning(stages: Any, found: dict[str, pd.DataFrame]) -> list[Part]:
    """Return the searches by system and length, and the estimates that they start from."""
    parts, sequences, estimates = [], stages.plan.test + stages.plan.train, 0
    for name in stages.plan.systems:
        system = SYSTEMS[name]
        strains = stages.plan.of(system).search.optimiser.strains
        for length, each in SEARCHES.items():
            of = {"system": MEASURED.get(name, name), "length": length}
            seconds, row = costing(found.get("planning"), "s a plan", **of)
            if seconds is not None:
                seconds *= strains / row["strains"]
            parts.append(Part(f"plans of {length}, {name}", sequences * each, seconds, device_of(row)))
        estimates += sequences * sum(SEARCHES.values()) * system.estimates
    seconds, row = costing(found.get("estimates"), "s each", estimate="refined")
    return [*parts, Part("estimates", estimates, seconds, device_of(row))]


def simulation(stages: Any, rows: pd.DataFrame | None, workers: int) -> Part:
    """Return the manipulations of the sequences and of the plans."""
    plans = len(stages.plan.systems) * (stages.plan.test + stages.plan.train) * sum(SEARCHES.values())
    number = stages.simulate.sequences * STEPS + plans
    seconds, _ = costing(rows, "CPU s each", step="all")
    return Part("manipulations", number, seconds, f"{workers} CPU cores", workers)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+", metavar="FOLDER")
    parser.add_argument("--simulation", type=Path, metavar="CSV")
    parser.add_argument("--cores", type=int, default=cores())
    parser.add_argument("--csv", type=Path)
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    stages: Any = params.scales["paper"]
    found = read(asked.folders)
    parts = [
        *training(stages, len(params.ensemble.members), found),
        *planning(stages, found),
        simulation(stages, pd.read_csv(asked.simulation) if asked.simulation else None, asked.cores),
    ]
    rows = [part.row() for part in parts]
    total = sum(row["hours"] for row in rows if row["hours"] is not None)
    missing = sum(row["hours"] is None for row in rows)
    rows.append(
        {"part": f"sum; {missing} parts have no rows", "device": "", "number": "", "hours": float(f"{total:.3g}")}
    )
    show("paper hours: scale paper", rows, csv=asked.csv)


if __name__ == "__main__":
    main()
