"""Sequences that a Dask cluster records, of which a worker is killed half-way: the same bytes as on one machine."""

import dataclasses
import os
import threading
import time
from concurrent.futures import BrokenExecutor
from pathlib import Path

import numpy as np
import pytest

from clothkit.simulation import executor
from clothkit.simulation.executor import end_workers, make_simulator
from clothkit.simulation.settings import SimulateConfig
from clothkit.simulation.solver import flat_state
from tests.simulation.test_generation import SCALE, SETTINGS, SIMULATION, contents, record

distributed = pytest.importorskip("distributed")
psutil = pytest.importorskip("psutil")


FOLDS = (
    np.stack([flat_state(SIMULATION) / np.float32(SCALE)] * 4),
    np.array([[[-0.7, -0.7], [-0.7, 0.7]], [[-0.7, -0.7]] * 2, [[0.7, 0.7]] * 2, [[0.7, -0.7], [0.7, 0.7]]]),
    np.array([[1.3, 0.0], [0.7, 0.7], [-0.6, -0.7], [-1.0, 0.1]]),
    np.array([False, True, True, False]),
)
"""Four flat cloths, and a manipulation of each."""


def kill_a_worker(work: Path, killed: list[int]) -> None:
    """Wait for the first stored block, then kill the process of one worker."""
    for _ in range(3000):
        if list(work.glob("block_*.npz")):
            break
        time.sleep(0.05)
    for process in psutil.Process().children(recursive=True):
        # Dask's worker processes are children of this one, and are spawned.
        if "spawn_main" in " ".join(process.cmdline()):
            killed.append(process.pid)
            process.kill()
            return


# Closed clusters leave sockets and tasks of their event loops to the garbage collector.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


def test_a_worker_that_is_lost_changes_no_byte(tmp_path: Path) -> None:
    settings = dataclasses.replace(SETTINGS, sequences=4)
    alone = record(tmp_path / "alone", settings)
    killed: list[int] = []
    killer = threading.Thread(target=kill_a_worker, args=(tmp_path / "dask/work", killed))
    killer.start()
    found = record(tmp_path / "dask", dataclasses.replace(settings, executor="dask", workers=2))
    killer.join()
    assert len(killed) == 1
    assert contents(found) == contents(alone)


def test_execution_does_not_depend_on_who_executes() -> None:
    """As stages and studies execute plans; each of the two workers has two cloths."""
    alone = make_simulator(SETTINGS)(*FOLDS)
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=2,
        processes=False,
        protocol="tcp",
        dashboard_address="127.0.0.1:0",
        silence_logs=50,
    ) as made:
        elsewhere = dataclasses.replace(SETTINGS, executor="dask", scheduler=made.scheduler_address)
        found = make_simulator(elsewhere)(*FOLDS)
        end_workers()
    np.testing.assert_array_equal(found, alone)


def test_a_pool_that_has_lost_a_process_is_not_used_again() -> None:
    """The call fails in which it is noticed; the next one gets processes of its own."""
    pool = executor._shared_pool("processes", 2, "")
    with pytest.raises(BrokenExecutor):
        pool.submit(os._exit, 1).result()
    with pytest.raises(BrokenExecutor):
        executor.execute(*FOLDS, settings=SIMULATION, workers=2)
    assert executor._shared_pool("processes", 2, "") is not pool
    end_workers()


def test_a_scheduler_without_its_executor_is_a_mistake() -> None:
    with pytest.raises(ValueError, match="expected executor: dask with it"):
        SimulateConfig(sequences=1, scheduler="tcp://head:8786")
