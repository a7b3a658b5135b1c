"""Start of Warp, with a writable folder for compiled kernels."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import warp as wp

from clothkit.runtime.cache import writable


def start_warp() -> None:
    """Start Warp on the CPU, with its own kernel folder if that is writable, else with a temporary one and a notice.

    Worker processes that are started afterwards use the same folder.
    """
    with _silent():
        try:
            wp.init()
        except OSError:
            # The folder can't be made. Warp has set kernel_cache_dir by now, so it is started below with another one.
            if wp.config.kernel_cache_dir is None:
                raise
    folder = Path(str(wp.config.kernel_cache_dir))
    chosen = writable(folder, "Warp's compiled kernels")
    if chosen is not None and chosen != folder:
        wp.config.kernel_cache_dir = os.environ["WARP_CACHE_PATH"] = str(chosen)
        with _silent():
            wp.init()
    wp.set_device("cpu")


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Discard what is written to stderr, since Warp's C code prints there that there is no CUDA driver."""
    stderr = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nowhere)
