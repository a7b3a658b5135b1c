"""Runs attempts at sequences with the clothkit on PYTHONPATH, without rejecting states; used by simulation.py.

    PYTHONPATH=CHECKOUT/src python benchmarks/run_attempts.py OUT.npz [--count 16] [--first 0] [--workers 1] [--side 32]
        [--block 4] [--executor processes]

The script runs attempts of seed 0 with the checkout's default settings, and writes their states, their settling times,
whether they came to rest, CPU and wall seconds (without compilation) and peak memory. It uses only functions that
exist in every version of the simulation, but with `--executor dask`, which gives the blocks to a Dask cluster of
`--workers` processes on this machine.
"""

import argparse
import functools
import json
import os
import resource
import time
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from clothkit.simulation import attempts
from clothkit.simulation.processes import make_pool
from clothkit.simulation.settings import Limits, SimulateConfig, SimulationConfig

WARM_UP = 900_000  # number of an extra attempt that a process runs first, so that nothing is compiled later
OPEN = Limits(height=9.0, residual_speed=9.0, strain_p99=9.0, strain_worst=9.0, intersections=10**6)


class Watch:
    """Replacements of `perform` and `reason` in the attempts, which record CPU seconds and rest and accept all states.

    States that aren't finite are still rejected, since no simulation can start from them.
    """

    def __init__(self) -> None:
        self.perform = attempts.perform
        self.seconds: list[float] = []
        self.rested: list[np.ndarray] = []

    def timed(self, *arguments):  # type: ignore[no-untyped-def]
        """Call `perform` and record its CPU seconds and which worlds came to rest."""
        started = time.process_time()
        taken, outcome = self.perform(*arguments)
        self.seconds.append(time.process_time() - started)
        self.rested.append(outcome.rested)
        return taken, outcome

    def lenient(self, quality, outcome, limits, index) -> str:  # type: ignore[no-untyped-def]
        """Return a reason to reject a state like `reason`, but only for states that aren't finite."""
        return "" if quality.finite[index] else "not finite"


def settings(side: int, changes: str) -> SimulateConfig:
    """Return the default settings for a grid side, with a JSON object of changes to the material."""
    simulation = SimulationConfig(side=side)
    if changes:
        material = type(simulation.material)(**json.loads(changes))
        simulation = SimulationConfig(side=side, material=material)
    return SimulateConfig(sequences=1, seed=0, simulation=simulation, limits=OPEN)


def run_block(first: int, count: int, side: int, changes: str) -> dict[str, np.ndarray]:
    """Run a block of attempts; return their arrays and measurements.

    The measurements are `rested` [attempts 3], `solver_seconds` [1 3], and the process's CPU seconds, id and peak
    memory.
    """
    warm_up(side, changes)
    watch = Watch()
    attempts.perform, attempts.reason = watch.timed, watch.lenient  # type: ignore[assignment]
    started = time.process_time()
    found = attempts.attempt_sequences(range(first, first + count), settings(side, changes))
    attempts.perform = watch.perform
    spent = time.process_time() - started
    rested = np.zeros((count, 3), bool)
    seconds = np.zeros(3)
    for step, (outcome, taken) in enumerate(zip(watch.rested, watch.seconds, strict=True)):
        rested[found.reached > step + 1, step] = outcome
        seconds[step] = taken
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    own = {"rested": rested, "solver_seconds": seconds[None], "cpu_seconds": np.array([spent])}
    return found._asdict() | own | {"process": np.array([os.getpid()]), "peak_mib": np.array([peak])}


@functools.cache
def warm_up(side: int, changes: str) -> None:
    """Load or compile the kernels, once per process."""
    cv2.setNumThreads(1)
    attempts.attempt_sequences(range(WARM_UP, WARM_UP + 1), settings(side, changes))


def open_workers(executor: str, workers: int) -> AbstractContextManager[Any]:
    """Return a pool of processes of this machine, or of workers of a Dask cluster that is started on it."""
    if executor == "processes":
        return make_pool(workers)
    from clothkit.simulation.processes import open_pool

    return open_pool("dask", workers=workers)


def main() -> None:
    """Run the attempts and write their arrays."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    for name, default in (("first", 0), ("count", 16), ("workers", 1), ("side", 32), ("block", 4)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--executor", choices=("processes", "dask"), default="processes")
    parser.add_argument("--material", default="", help='JSON: {"shear_stiffness": 20.0}')
    options = parser.parse_args()
    last = options.first + options.count
    same = (options.side, options.material)
    jobs = [(at, min(options.block, last - at), *same) for at in range(options.first, last, options.block)]
    if options.workers == 1 and options.executor == "processes":
        warm_up(*same)
        started = time.perf_counter()
        blocks = [run_block(*job) for job in jobs]
    else:
        with open_workers(options.executor, options.workers) as pool:
            for warm in [pool.submit(warm_up, *same) for _ in range(options.workers)]:
                warm.result()
            started = time.perf_counter()
            blocks = [done.result() for done in [pool.submit(run_block, *job) for job in jobs]]
    wall = time.perf_counter() - started
    arrays = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    arrays |= {"wall_seconds": np.array(wall), "own_mib": np.array(own), "own_process": np.array(os.getpid())}
    np.savez(options.out, **arrays)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
