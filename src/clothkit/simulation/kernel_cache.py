"""Where Warp keeps compiled kernels."""

import functools
import os
from pathlib import Path

import warp as wp

from clothkit.cache import writable


@functools.cache
def ensure_kernel_cache() -> None:
    """Let Warp, here and in worker processes, keep kernels in its folder if that can be written, else in a temporary.

    Before a process's first launch, and before its workers are made.
    """
    try:
        wp.init()
    except OSError:
        # Warp has chosen the folder by now, and comes to an end below.
        if wp.config.kernel_cache_dir is None:
            raise
    folder = Path(str(wp.config.kernel_cache_dir))
    chosen = writable(folder, "Warp's compiled kernels")
    if chosen is not None and chosen != folder:
        wp.config.kernel_cache_dir = os.environ["WARP_CACHE_PATH"] = str(chosen)
        wp.init()
