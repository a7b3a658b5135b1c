"""How Warp is started: with a folder for compiled kernels that can be written."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import warp as wp

from clothkit.cache import writable


def start_warp() -> None:
    """Start Warp; kernels are kept in its folder if that can be written, else in a temporary one, which is said.

    Worker processes that are made afterwards keep them in the same.
    """
    with _silent():
        try:
            wp.init()
        except OSError:
            # The folder can't be made: Warp has chosen it by now, and starts below with another.
            if wp.config.kernel_cache_dir is None:
                raise
    folder = Path(str(wp.config.kernel_cache_dir))
    chosen = writable(folder, "Warp's compiled kernels")
    if chosen is not None and chosen != folder:
        wp.config.kernel_cache_dir = os.environ["WARP_CACHE_PATH"] = str(chosen)
        with _silent():
            wp.init()


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Without Warp's complaint, from C, that there is no CUDA driver."""
    stderr = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nowhere)
