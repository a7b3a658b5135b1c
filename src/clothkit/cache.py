"""Folders of compiled programs that can't be written are replaced by temporary ones, and that is said."""

import atexit
import contextlib
import shutil
import sys
import tempfile
from pathlib import Path

import jax


def writable(folder: Path, programs: str) -> Path | None:
    """The folder, made where it is not there; a temporary one, gone with this process, where nothing can be written.

    None where there is no room for that either. `programs` says in the notice on stderr what can't be kept.
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


def ensure_jax_cache() -> None:
    """Let JAX keep compiled programs where it is told to if that can be written, else in a temporary folder."""
    folder = jax.config.values.get("jax_compilation_cache_dir")
    if folder and "://" not in folder:
        chosen = writable(Path(folder), "JAX's compiled programs")
        jax.config.update("jax_compilation_cache_dir", None if chosen is None else str(chosen))
