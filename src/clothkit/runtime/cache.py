"""Folders in which compiled programs are kept for later runs; one that can't be written is replaced, with a notice."""

import atexit
import contextlib
import shutil
import sys
import tempfile
from pathlib import Path

import filelock
import jax

COMPILED_BYTES = 2**30
"""Size limit of a cache of compiled programs."""

LEAST_SECONDS = 0.0
"""Programs that compile faster are not kept. JAX's own limit is a second; but a command has hundreds of small programs,
and together they are a sixth of its start."""


LOCK_SECONDS = 10.0
"""How long to wait for the lock of a cache of compiled programs; as long as JAX."""


def writable(folder: Path, programs: str) -> Path | None:
    """Return `folder`, created if it is missing, or a new temporary folder if `folder` can't be written.

    The temporary folder is deleted when the process ends. Returns None if that can't be created either. In both cases
    a notice on stderr says so; `programs` names what the folder would have held.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError as error:
        reason = error.strerror
    instead = None
    with contextlib.suppress(OSError):
        instead = Path(tempfile.mkdtemp(prefix="clothkit-compiled-"))
        atexit.register(shutil.rmtree, instead, ignore_errors=True)
    place = f"kept in {instead} for this run" if instead else "not kept"
    print(f"{folder}: can't be written ({reason}); {programs} are {place}", file=sys.stderr)
    return instead


def drop_unfinished(folder: Path) -> None:
    """Delete compiled programs in `folder` that a killed process left half written.

    JAX writes a program to `KEY-cache` and then the time of its last use to `KEY-atime`, both under a lock. It
    would never replace a half-written program, but warn of it at every start. Where the lock can't be had, nothing is
    deleted.
    """
    # A file system without locks raises NotImplementedError, and filelock.Timeout is an OSError.
    with contextlib.suppress(OSError, NotImplementedError), filelock.FileLock(folder / ".lockfile", LOCK_SECONDS):
        for program in folder.glob("*-cache"):
            if not program.with_name(program.name.removesuffix("cache") + "atime").exists():
                program.unlink()


def ensure_jax_cache(default: Path) -> None:
    """Let JAX keep compiled programs in its configured folder, which is `default` if none is configured.

    A folder that can't be written is replaced by a temporary one, or by none. URLs are not checked. Half-written
    programs in `default` are deleted.
    """
    folder = jax.config.values.get("jax_compilation_cache_dir")
    if own := folder is None:
        folder = str(default)
        jax.config.update("jax_compilation_cache_dir", folder)
        jax.config.update("jax_compilation_cache_max_size", COMPILED_BYTES)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", LEAST_SECONDS)
    if folder and "://" not in folder:
        chosen = writable(Path(folder), "JAX's compiled programs")
        jax.config.update("jax_compilation_cache_dir", None if chosen is None else str(chosen))
        if own and chosen is not None:
            drop_unfinished(chosen)
