"""What does it take to record a million sequences?  python benchmarks/million.py [SEQUENCES ..] [options]

A dry run of stage simulate: attempts are made once and copied, so that all time is spent on storing and reading blocks
and on writing the dataset. It runs for each number of SEQUENCES (default: 2000 and 4000), with `--block` attempts in a
block (default: 64), and measures seconds, files, bytes and the growth of memory of the process that stores blocks.

From the largest run and `--cpu` seconds of one core for a manipulation (default: 0.66, benchmarks/simulation.py steps),
the second table tells by arithmetic what `--wanted` sequences (default: a million) take on 1, 16 and 256 cores: hours,
how busy the storing process is, through which all blocks pass, and the memory in which stage regularise and the
training hold all meshes. `--csv FOLDER` writes the tables.
"""

import argparse
import dataclasses
import functools
import resource
import tempfile
import time
from pathlib import Path
from unittest import mock

import numpy as np
from tables import show

from clothkit.cloth.topology import Topology
from clothkit.simulation import generation
from clothkit.simulation.attempts import Attempts, attempt_sequences
from clothkit.simulation.records import SHARD
from clothkit.simulation.settings import SimulateConfig

CORES = (1, 16, 256)
MADE = 8  # attempts that are really simulated
MANIPULATIONS = 3  # of an attempt


def copies(made: Attempts, numbers: range, **_: object) -> Attempts:
    """Return attempts of these numbers, each a copy of one that was made."""
    chosen = np.array(numbers) % len(made.attempt)
    found = Attempts(*(values[chosen] for values in made))
    # Copies would be compressed to nothing.
    noise = np.random.default_rng(numbers.start).normal(scale=1e-5, size=found.states.shape)
    return found._replace(attempt=np.array(numbers), states=found.states + noise.astype(np.float32))


def peak_mib() -> float:
    """Return the largest memory of this process so far, in MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def run(sequences: int, block: int, made: Attempts, topology: Topology) -> dict:
    """Record sequences that are copies, and return the row of the table."""
    settings = SimulateConfig(sequences=sequences, block=block, workers=1)
    with (
        tempfile.TemporaryDirectory(dir=".") as folder,
        mock.patch.object(generation, "attempt_sequences", functools.partial(copies, made)),
    ):
        before, started = peak_mib(), time.perf_counter()
        found = generation.generate(
            Path(folder) / "raw", settings, work=Path(folder) / "work", attributes={}, topology=topology
        )
        seconds = time.perf_counter() - started
        files = [path for path in Path(folder).rglob("*") if path.is_file()]
        own = {kind: [path for path in files if kind in path.parts] for kind in ("work", "raw")}
        size = {kind: sum(path.stat().st_size for path in paths) for kind, paths in own.items()}
    return {
        "sequences": sequences,
        "attempts": found.attempts,
        "block": block,
        "s": round(seconds, 1),
        "ms a block": round(seconds / len(own["work"]) * 1e3, 1),
        "blocks' files": len(own["work"]),
        "dataset's files": len(own["raw"]),
        "kB of blocks each": round(size["work"] / sequences / 1e3),
        "kB of dataset each": round(size["raw"] / sequences / 1e3),
        "MiB more": round(peak_mib() - before),
        "mesh bytes": made.states[0].nbytes,
    }


def projected(row: dict, wanted: int, cpu: float) -> list[dict]:
    """Return what `wanted` sequences take, by the measured cost of a sequence."""
    times, attempts = wanted / row["sequences"], row["attempts"] / row["sequences"] * wanted
    found = []
    for cores in CORES:
        hours = attempts * MANIPULATIONS * cpu / cores / 3600
        storing = row["s"] * times / 3600
        found.append(
            {
                "sequences": wanted,
                "cores": cores,
                "hours of simulation": round(hours, 1),
                "hours of storing": round(storing, 1),
                "share of time that storing is busy": f"{min(storing / hours, 9.99):.1%}",
                "blocks a second": round(attempts / row["block"] / hours / 3600, 2),
                "blocks' files": round(row["blocks' files"] * times),
                "dataset's files": row["dataset's files"] + (wanted - row["sequences"]) // SHARD,
                "GB of blocks": round(row["kB of blocks each"] * wanted / 1e6),
                "GB of dataset": round(row["kB of dataset each"] * wanted / 1e6),
                "GB of meshes in memory": round(wanted * row["mesh bytes"] / 1e9),
            }
        )
    return found


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", type=int, nargs="*", default=[2000, 4000])
    parser.add_argument("--block", type=int, default=64)
    parser.add_argument("--cpu", type=float, default=0.66)
    parser.add_argument("--wanted", type=int, default=10**6)
    parser.add_argument("--csv", type=Path)
    asked = parser.parse_args()
    settings = SimulateConfig(sequences=1)
    topology = settings.simulation.topology
    made = attempt_sequences(range(MADE), dataclasses.replace(settings, block=MADE), topology)
    rows = [run(count, asked.block, made, topology) for count in sorted(asked.sequences)]
    show("recording: a dry run", rows, csv=asked.csv)
    show("recording a million: by arithmetic", projected(rows[-1], asked.wanted, asked.cpu), csv=asked.csv)


if __name__ == "__main__":
    main()
