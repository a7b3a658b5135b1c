"""How long does the simulation take, and how good are its states?  python benchmarks/simulation.py [WHAT ..] [options]

WHAT is `vertices` (cost against vertices per side), `sequences` (cost against their number, with one worker, two, and
two of a Dask cluster on this machine), `blocks` (cost against the number of attempts that a process runs at a time, in
one launch) or `steps` (cost and quality of steps 1, 2, 3); default: all of them. Options:

`--against PATH` compares this checkout with another checkout of this repository on the same attempts.
`--count N` is the number of attempts (default: 16) for `steps`, `blocks` and `--against`, `--sizes 16 64 1024` those
for `sequences`. `--csv FOLDER` writes CSV files.
`--material '{"shear_stiffness": 20.0}'` changes this checkout's material. `--block N` is the number of attempts that a
process runs at a time (default: 4).

The same checks are applied to both checkouts, and no state is rejected, so step 3 starts from bad states, too. A
sequence is `sound` if its states have no intersection, nothing below the table, a gap of at least half the thickness,
strain p99 <= 3 % and worst <= 10 %, a height <= 0.125, and are at rest according to the solver that made them (by
means over 50 ms in the first version, over 10 ms in later ones). CPU seconds are those of one core, including sampling
and checks, without compilation.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from tables import show, write

import clothkit
from clothkit.simulation.quality import measure
from clothkit.simulation.settings import SimulationConfig

HERE = Path(__file__).resolve().parent
THICKNESS = SimulationConfig().material.thickness
VIEWPORT = 0.125  # normalised
STRAIN_P99, STRAIN_WORST, RESIDUAL_SPEED = 0.03, 0.1, 0.01
SIDES = (16, 32, 48, 64)
ON_EACH_SIDE = 4  # attempts per grid side; few, since a side of 64 takes minutes
BLOCKS = (1, 4, 16)  # attempts that a process runs at a time
EXECUTORS = (("processes", 1), ("processes", 2), ("dask", 2))
FAULTS = ("crossed", "high", "p99", "worst", "thin", "below", "restless")


def run(count: int, *, workers: int = 1, side: int = 32, source: Path | None = None, how: dict | None = None) -> dict:
    """Run run_attempts.py with the clothkit in a source folder (default: this one) and return the arrays it writes.

    `how` holds further options of run_attempts.py, which are the same for a whole table.
    """
    source = source or Path(clothkit.__file__).parents[1]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "attempts.npz"
        options = {"count": count, "workers": workers, "side": side} | (how or {})
        command = [sys.executable, str(HERE / "run_attempts.py"), str(out)]
        command += [word for name, value in options.items() for word in (f"--{name}", str(value))]
        subprocess.run(command, check=True, env=os.environ | {"PYTHONPATH": str(source)})
        with np.load(out) as arrays:
            return dict(arrays)


def manipulations(got: dict) -> int:
    """Return how many manipulations were executed."""
    return int((got["reached"] - 1).clip(0).sum())


def peak_mib(got: dict) -> float:
    """Return the sum of the peak memory of all processes, in MiB."""
    peaks = {int(got["own_process"]): float(got["own_mib"])}
    for process, peak in zip(got["process"].tolist(), got["peak_mib"].tolist(), strict=True):
        peaks[process] = max(peaks.get(process, 0.0), peak)
    return sum(peaks.values())


def judge(got: dict, side: int) -> dict[str, np.ndarray]:
    """Return the faults of each state after a manipulation, bool [attempts 3] by name.

    `there` is True for states that were reached; all faults but `bad` are False for the others.
    """
    there = got["reached"][:, None] > np.arange(1, 4)
    found = {
        name: np.zeros(there.shape, bool) for name in ("crossed", "high", "p99", "worst", "thin", "below", "restless")
    }
    for step in range(3):
        rows = np.flatnonzero(there[:, step])
        quality = measure(got["states"][rows, step + 1], SimulationConfig(side=side))
        found["crossed"][rows, step] = quality.intersections > 0
        found["high"][rows, step] = quality.height > VIEWPORT
        found["p99"][rows, step] = quality.strain_p99 > STRAIN_P99
        found["worst"][rows, step] = quality.strain_worst > STRAIN_WORST
        found["thin"][rows, step] = quality.gap < THICKNESS / 2
        found["below"][rows, step] = quality.lowest < 0
        moving = got["residual_speed"][rows, step + 1] > RESIDUAL_SPEED
        found["restless"][rows, step] = ~got["rested"][rows, step] | moving
    return {"there": there, **found, "bad": ~there | np.any(list(found.values()), axis=0)}


def quality_rows(name: str, got: dict, side: int = 32) -> list[dict]:
    """Return a row per step and one for the whole sequences."""
    judged = judge(got, side)
    rows = []
    for step in range(3):
        there = judged["there"][:, step]
        share = {
            key: f"{judged[key][there, step].mean():.0%}"
            for key in ("crossed", "high", "p99", "worst", "thin", "restless")
        }
        rows.append(
            {
                "solver": name,
                "step": step + 1,
                "states": int(there.sum()),
                "sound so far": f"{1 - judged['bad'][:, : step + 1].any(1).mean():.0%}",
                "intersecting": share["crossed"],
                "over viewport": share["high"],
                "strain p99 > 3%": share["p99"],
                "worst > 10%": share["worst"],
                "gap < half": share["thin"],
                "not at rest": share["restless"],
                "median settle s": round(float(np.median(got["settle_time"][there, step])), 2),
                "solver CPU s": round(float(got["solver_seconds"][:, step].sum()) / max(int(there.sum()), 1), 3),
            }
        )
    sound = 1 - judged["bad"].any(1).mean()
    spent = float(got["cpu_seconds"].sum())
    whole = {"solver": name, "step": "all", "states": manipulations(got), "sound so far": f"{sound:.0%}"}
    per_sound = f"{spent / max(sound * len(judged['bad']), 1e-9):.2f}" if sound else "none"
    return [*rows, whole | {"CPU s each": round(spent / manipulations(got), 3), "CPU s a sound sequence": per_sound}]


def vertices_rows(how: dict) -> Iterator[dict]:
    """Yield a row per number of vertices."""
    for side in SIDES:
        got = run(ON_EACH_SIDE, side=side, how=how)
        judged = judge(got, side)
        per = float(got["cpu_seconds"].sum()) / manipulations(got)
        yield {
            "side": side,
            "vertices": side**2,
            "CPU s each": round(per, 3),
            "us a vertex": round(per / side**2 * 1e6, 0),
            "median settle s": [round(float(t), 2) for t in np.median(got["settle_time"], axis=0)],
            "intersecting": f"{judged['crossed'].mean():.0%}",
            "over viewport": f"{judged['high'].mean():.0%}",
            "strain p99 > 3%": f"{judged['p99'].mean():.0%}",
            "sound sequences": f"{1 - judged['bad'].any(1).mean():.0%}",
        }


def sequences_rows(sizes: list[int], how: dict) -> Iterator[dict]:
    """Yield a row per number of sequences and workers."""
    for count in sizes:
        for executor, workers in EXECUTORS:
            got = run(count, workers=workers, how=how | {"executor": executor})
            yield {"sequences": count, "executor": executor, "workers": workers} | costs(got)


def blocks_rows(count: int, how: dict) -> Iterator[dict]:
    """Yield a row per number of attempts in a block, for two processes."""
    for block in BLOCKS:
        got = run(count, workers=2, how=how | {"block": block})
        yield {"block": block, "attempts": count, "workers": 2} | costs(got)


def costs(got: dict) -> dict:
    """Return how many manipulations there were, and what they took."""
    done, wall = manipulations(got), float(got["wall_seconds"])
    return {
        "manipulations": done,
        "wall s": round(wall, 1),
        "wall s each": round(wall / done, 3),
        "CPU s each": round(float(got["cpu_seconds"].sum()) / done, 3),
        "peak MiB, all processes": round(peak_mib(got)),
    }


def collect(title: str, found: Iterable[dict], csv: Path | None) -> None:
    """Show the rows of a table, each of which is written as soon as it is found."""
    rows: list[dict] = []
    for row in found:
        rows.append(row)
        write(title, rows, csv)
    show(title, rows, csv=csv)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", metavar="WHAT")
    parser.add_argument("--against", type=Path)
    parser.add_argument("--count", type=int, default=16)
    parser.add_argument("--sizes", type=int, nargs="+", default=[16, 64])
    parser.add_argument("--material", default="")
    parser.add_argument("--block", type=int, default=4)
    parser.add_argument("--csv", type=Path)
    options = parser.parse_args()
    tables = ["vertices", "sequences", "blocks", "steps"]
    if unknown := set(options.what) - set(tables):
        parser.error(f"{' '.join(sorted(unknown))}: expected some of {', '.join(tables)}")
    how = {name: getattr(options, name) for name in ("material", "block")}
    what = options.what or ([] if options.against else tables)
    if "vertices" in what:
        collect("simulation vertices: cost against vertices a side", vertices_rows(how), options.csv)
    if "sequences" in what:
        collect("simulation sequences: cost against their number", sequences_rows(options.sizes, how), options.csv)
    if "blocks" in what:
        collect("simulation blocks: cost against attempts at a time", blocks_rows(options.count, how), options.csv)
    if "steps" in what or options.against:
        rows = quality_rows("this", run(options.count, how=how))
        if options.against:
            rows += quality_rows("other", run(options.count, source=options.against.resolve() / "src"))
        show(f"simulation steps: cost and quality, {options.count} attempts of seed 0", rows, csv=options.csv)


if __name__ == "__main__":
    main()
