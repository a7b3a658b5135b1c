"""What does it take to record a million sequences?  python benchmarks/million.py [SEQUENCES ..] [options]

A dry run of stage simulate: attempts are made once and copied, so that all time is spent on handing out, storing and
reading blocks and on writing the dataset. It runs for each number of SEQUENCES (default: 2000 and 4000) with each
number of attempts in a `--block` (default: 4 and 64). CPU seconds are told, which other programs change little.
- `--dask N`: the copies are made by N workers of a Dask cluster on this machine, whose scheduler is a process of its
  own. Its CPU seconds are told, and the bytes on the loopback interface, those of other programs included.
- `--variation`: every sequence has a rectangle of its own, as in a world with `simulate.variation`.
- `--files N`: what it takes to make, find and open so many empty files in one folder, beside a thousand.

From the largest runs and `--cpu` seconds of one core for an accepted sequence (default: those of stage simulate in
reports/laptop), the second table tells by arithmetic what `--wanted` sequences (default: a million) take on 1, 16 and
256 cores: hours, and how busy the processes are through which all blocks pass. `--csv FOLDER` writes the tables.
"""

import argparse
import dataclasses
import functools
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pandas as pd
from ruamel.yaml import YAML
from tables import show

from clothkit.cloth.topology import Topology
from clothkit.runtime.resumable import load_piece
from clothkit.simulation import generation
from clothkit.simulation.attempts import Attempts, attempt_sequences
from clothkit.simulation.generation import BLOCKS
from clothkit.simulation.records import SHARD
from clothkit.simulation.settings import SimulateConfig

CORES = (1, 16, 256)
MADE = 2  # attempts that are really simulated
REPORT = Path("reports/laptop")


def copies(made: Path, numbers: range, *, variation: bool = False, **_: object) -> Attempts:
    """Return attempts of these numbers, each a copy of one that was made."""
    stored = load_piece(made, BLOCKS)
    chosen = np.array(numbers) % len(stored.attempt)
    found = Attempts(*(values[chosen] for values in stored))
    rng = np.random.default_rng(numbers.start)
    # Copies would be compressed to nothing.
    noise = rng.normal(scale=1e-5, size=found.states.shape)
    if variation:
        found = found._replace(sides=rng.uniform(0.2, 0.4, found.sides.shape))
    return found._replace(attempt=np.array(numbers), states=found.states + noise.astype(np.float32))


def peak_mib() -> float:
    """Return the largest memory of this process so far, in MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


class Cluster:
    """A Dask scheduler and its workers, each a process of this machine."""

    def __init__(self, address: Path, process: "subprocess.Popen[bytes]") -> None:
        import psutil

        self.address = str(address)
        self._scheduler, self._network = psutil.Process(process.pid), psutil.net_io_counters

    def spent(self) -> np.ndarray:
        """Return CPU seconds of the scheduler, and MB on the loopback interface, until now."""
        times = self._scheduler.cpu_times()
        return np.array([times.user + times.system, self._network(pernic=True)["lo"].bytes_sent / 1e6])


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[Cluster]:
    """Start a cluster, and end it afterwards."""
    place = folder / "scheduler.json"
    quiet: dict[str, Any] = {
        "cwd": folder,
        "env": {**os.environ, "PYTHONPATH": os.path.abspath("src")},
        "stderr": subprocess.DEVNULL,
    }
    cli = [sys.executable, "-m", "distributed.cli.dask_"]
    scheduler = ["--scheduler-file", str(place), "--port", "0", "--dashboard-address", "127.0.0.1:0"]
    worker = ["--scheduler-file", str(place), "--no-nanny", "--no-dashboard", "--nthreads", "1"]
    commands = [[*cli[:2], f"{cli[2]}scheduler", *scheduler]] + [[*cli[:2], f"{cli[2]}worker", *worker]] * workers
    with ExitStack() as stack:
        processes = []
        for command in commands:
            processes.append(subprocess.Popen(command, **quiet))
            stack.callback(processes[-1].wait)
            stack.callback(processes[-1].terminate)
        while not place.exists():
            time.sleep(0.1)
        yield Cluster(place, processes[0])


def run(
    sequences: int, block: int, asked: argparse.Namespace, made: Path, topology: Topology, dask: Cluster | None
) -> dict:
    """Record sequences that are copies, and return the row of the table."""
    chosen: dict[str, Any] = {} if dask is None else {"executor": "dask", "scheduler": dask.address}
    settings = SimulateConfig(sequences=sequences, block=block, workers=1, **chosen)
    stub = functools.partial(copies, made, variation=asked.variation)
    with (
        tempfile.TemporaryDirectory(dir=made.parent) as folder,
        mock.patch.object(generation, "attempt_sequences", stub),
    ):
        before, started = peak_mib(), time.process_time()
        spent = None if dask is None else dask.spent()
        found = generation.generate(
            Path(folder) / "raw", settings, work=Path(folder) / "work", attributes={}, topology=topology
        )
        seconds = time.process_time() - started
        files = [path for path in Path(folder).rglob("*") if path.is_file()]
        own = {kind: [path for path in files if Path(folder, kind) in path.parents] for kind in ("work", "raw")}
        size = {kind: sum(path.stat().st_size for path in paths) for kind, paths in own.items()}
    row = {
        "sequences": sequences,
        "workers": asked.dask,
        "rectangles": sequences if asked.variation else 1,
        "attempts": found.attempts,
        "block": block,
        "storing CPU s": round(seconds, 2),
        "blocks' files": len(own["work"]),
        "dataset's files": len(own["raw"]),
        "kB of blocks each": round(size["work"] / sequences / 1e3),
        "kB of dataset each": round(size["raw"] / sequences / 1e3),
        "storing MiB": round(peak_mib()),
        "storing MiB more": round(peak_mib() - before),
    }
    if dask is not None and spent is not None:
        scheduler, megabytes = dask.spent() - spent
        row |= {"scheduler CPU s": round(float(scheduler), 2), "MB on loopback": round(float(megabytes))}
    return row


def projected(row: dict, wanted: int, cpu: float) -> list[dict]:
    """Return what `wanted` sequences take, by the measured cost of a sequence; simulated with `cpu` seconds each."""
    times, attempts = wanted / row["sequences"], row["attempts"] / row["sequences"] * wanted
    found = []
    for cores in CORES:
        hours = wanted * cpu / cores / 3600
        busy = {
            name: row[f"{name} CPU s"] * times / 3600 for name in ("storing", "scheduler") if f"{name} CPU s" in row
        }
        found.append(
            {
                "sequences": wanted,
                "cores": cores,
                "block": row["block"],
                "CPU s a sequence": round(cpu, 3),
                "hours of simulation": round(hours, 1),
                **{f"hours of {name}": round(own, 2) for name, own in busy.items()},
                **{f"{name} is busy [%]": round(100 * own / hours, 2) for name, own in busy.items()},
                "blocks a second": round(attempts / row["block"] / hours / 3600, 2),
                "blocks' files": round(row["blocks' files"] * times),
                "dataset's files": row["dataset's files"] + (wanted - row["sequences"]) // SHARD,
                "GB of blocks": round(row["kB of blocks each"] * wanted / 1e6),
                "GB of dataset": round(row["kB of dataset each"] * wanted / 1e6),
            }
        )
    return found


def in_one_folder(count: int) -> dict:
    """Return CPU microseconds, user and system, to make, find and open a file in a folder of `count` empty ones."""
    with tempfile.TemporaryDirectory(dir=".") as folder:
        paths = [Path(folder) / f"block_4_{number:06d}.npz" for number in range(count)]
        probed = paths[:: max(1, count // 1000)]

        def each(of: list[Path], use: Callable[[Path], object]) -> float:
            started = time.process_time()
            for path in of:
                use(path)
            return round((time.process_time() - started) / len(of) * 1e6, 1)

        return {
            "files": count,
            "make [us]": each(paths, Path.touch),
            "find [us]": each(probed, Path.exists),
            "open [us]": each(probed, Path.read_bytes),
            "list [s]": each([Path(folder)], lambda path: sum(1 for _ in os.scandir(path))) / 1e6,
        }


def measured(report: Path) -> float:
    """Return CPU seconds of stage simulate for an accepted sequence, in a report."""
    params = YAML(typ="safe").load(report / "params.yaml")
    seconds = pd.read_csv(report / "timings.csv").set_index("stage")["cpu_seconds"].to_dict()
    return float(seconds["simulate"]) / params["scales"][params["scale"]]["simulate"]["sequences"]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", type=int, nargs="*", default=[2000, 4000])
    parser.add_argument("--block", type=int, nargs="+", default=[4, 64])
    parser.add_argument("--dask", type=int, default=0, metavar="WORKERS")
    parser.add_argument("--variation", action="store_true")
    parser.add_argument("--files", type=int, default=0)
    parser.add_argument("--cpu", type=float)
    parser.add_argument("--wanted", type=int, default=10**6)
    parser.add_argument("--csv", type=Path)
    asked = parser.parse_args()
    if asked.files:
        rows = [in_one_folder(count) for count in (1000, asked.files)]
        show("recording files: empty ones in one folder", rows, csv=asked.csv)
        return
    settings = SimulateConfig(sequences=1)
    topology = settings.simulation.topology
    cpu = measured(REPORT) if asked.cpu is None else asked.cpu
    title = "recording with dask" if asked.dask else "recording rectangles" if asked.variation else "recording"
    with tempfile.TemporaryDirectory(dir=".") as folder, ExitStack() as stack:
        made = Path(folder).resolve() / "made.npz"
        BLOCKS.save(made, attempt_sequences(range(MADE), dataclasses.replace(settings, block=MADE), topology))
        dask = stack.enter_context(cluster(made.parent, asked.dask)) if asked.dask else None
        tried = [(count, block) for count in sorted(asked.sequences) for block in asked.block]
        rows = [run(*pair, asked, made, topology, dask) for pair in tried]
    told = [one for row in rows[-len(asked.block) :] for one in projected(row, asked.wanted, cpu)]
    show(f"{title}: a dry run", rows, csv=asked.csv)
    show(f"{title} a million: by arithmetic", told, csv=asked.csv)


if __name__ == "__main__":
    main()
