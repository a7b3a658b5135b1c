"""Replace a cache folder of compiled programs that can't be written by a temporary folder, with a notice."""

import atexit
import contextlib
import shutil
import sys
import tempfile
from pathlib import Path

import jax


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


def ensure_jax_cache() -> None:
    """Let JAX use its configured cache folder if that can be written, else a temporary one, else none.

    URLs are not checked.
    """
    folder = jax.config.values.get("jax_compilation_cache_dir")
    if folder and "://" not in folder:
        chosen = writable(Path(folder), "JAX's compiled programs")
        jax.config.update("jax_compilation_cache_dir", None if chosen is None else str(chosen))
