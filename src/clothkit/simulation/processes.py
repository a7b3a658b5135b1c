"""Pools of workers: processes of this machine, which use one thread each and end when their parent ends, or Dask's."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Literal

import cv2

from clothkit.runtime.dask_pool import DaskPool, open_dask

Kind = Literal["processes", "dask"]


class ProcessPool(ProcessPoolExecutor):
    """A pool of spawned processes of this machine."""

    def __init__(self, workers: int) -> None:
        super().__init__(workers, mp_context=multiprocessing.get_context("spawn"), initializer=_start)
        self.width = workers
        """Number of pieces that are computed at a time."""


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0))


def make_pool(workers: int) -> ProcessPool:
    """Return a pool of `workers` spawned processes."""
    return ProcessPool(workers)


@contextmanager
def open_pool(kind: Kind, *, workers: int, scheduler: str = "") -> Iterator[ProcessPool | DaskPool]:
    """A pool, which is shut down afterwards: what it has not begun yet is dropped.

    `workers` is for those that are started on this machine; `scheduler` is as in `open_dask`, which raises InputError.
    """
    if kind == "dask":
        with open_dask(scheduler, workers=workers) as cluster:
            yield cluster
        return
    pool = make_pool(workers)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _start() -> None:
    # Ctrl-C reaches the whole process group; workers ignore it, and the parent ends the pool after the current jobs.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this process when its parent ends: after a kill of the parent it would wait for work forever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
