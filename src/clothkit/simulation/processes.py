"""Worker processes: spawned, one thread each, gone when their parent is gone."""

import multiprocessing
import os
import signal
import threading
from concurrent.futures import ProcessPoolExecutor

import cv2


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0))


def make_pool(workers: int) -> ProcessPoolExecutor:
    """A pool of so many spawned processes."""
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=_start)


def _start() -> None:
    # Ctrl-C reaches the whole group; the parent ends the pool after what is under way.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A parent that was killed can't tell its workers, and they would wait for work forever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
