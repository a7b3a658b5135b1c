"""`InputError`, the exception whose message users read, and the conversion of operating system errors to it."""

import errno
import os
import sys
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import Literal


class InputError(ValueError):
    """Bad input. The message is one sentence that names the file, the field and what was expected."""


_REMEDIES = {
    errno.EACCES: "no permission; change the file's or its folder's permissions",
    errno.EPERM: "not permitted; change the file's owner or attributes",
    errno.EROFS: "its file system is read-only; choose another place, or mount it for writing",
    errno.EISDIR: "it is a folder, expected a file",
    errno.ENOTDIR: "a part of its path is a file, expected a folder",
    errno.ENAMETOOLONG: "its name is too long; choose a shorter one",
    errno.ELOOP: "its symbolic links lead in a circle",
    errno.EEXIST: "something of that name is there already; move it away, or choose another name",
    errno.ENOTEMPTY: "the folder in its place is not empty",
    errno.ENOSPC: "no space is left; free some and run again",
    errno.EDQUOT: "the disk quota is used up; free some space and run again",
    errno.EFBIG: "the file would be larger than its file system allows",
    errno.EMFILE: "too many files are open; raise the limit (ulimit -n)",
    errno.EBUSY: "it is in use, or another file system is mounted there",
    errno.EXDEV: "it is on another file system",
    errno.EIO: "the disk reports an error",
}
_OF_DISKS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def system_error(
    error: OSError, path: Path | str, *, action: Literal["read", "written", "opened"] = "read", expected: str = ""
) -> InputError:
    """Convert an operating system error to one sentence: the file, what can't be done with it, why, and what to do.

    `expected` describes the file that should be there, or the command that creates it. The caller raises the returned
    error `from` the original. An OSError that a library raised without an errno keeps its own text.
    """
    expected = f", expected {expected}" if expected else ""
    if error.errno == errno.ENOENT:
        if action == "read":
            return InputError(f"{path}: not found{expected}")
        return InputError(f"{path}: can't be {action}: its folder is not there; make it first")
    reason = _REMEDIES.get(error.errno or 0) or error.strerror or " ".join(str(error).split()) or type(error).__name__
    return InputError(f"{path}: can't be {action}{expected}: {reason}")


def damaged_piece(error: Exception, path: Path) -> InputError:
    """Return the sentence for a stored piece of work that a power cut or a full disk has damaged."""
    reason = (str(error).splitlines() or [type(error).__name__])[0]
    kind = "folder" if path.is_dir() else "file"
    return InputError(f"{path}: what an earlier run left is damaged ({reason}); delete this {kind} and run again")


def untold_error(error: Exception) -> InputError | None:
    """Convert an error that no inner handler has converted; None if the error is a bug in the program.

    For the outermost handler of a command or stage. Converts operating system errors that name a file, errors of a full
    or broken disk (a failed write names no file), the end of a worker process, and errors of JAX when the device that
    was asked for is missing.
    """
    if isinstance(error, OSError):
        named = error.filename2 or error.filename
        if isinstance(named, bytes):
            named = os.fsdecode(named)
        if isinstance(named, str | Path) and error.errno != errno.EPIPE:
            return system_error(error, named, action="read" if error.errno == errno.ENOENT else "opened")
        if error.errno in _OF_DISKS:
            return InputError(f"a file can't be written: {_REMEDIES[error.errno]}")
    if isinstance(error, BrokenExecutor):
        return InputError(
            "a worker process ended abruptly (was it killed, or memory short?); free some memory, or set fewer workers "
            "(simulate.workers), and run again"
        )
    return _missing_device() if isinstance(error, RuntimeError | AssertionError) else None


def _missing_device() -> InputError | None:
    """Return an InputError if JAX can't use the platform that it was asked for, else None.

    JAX may raise an assertion without a message when a platform's plugin is missing, so this asks JAX for its devices
    again.
    """
    jax = sys.modules.get("jax")
    asked = None if jax is None else jax.config.jax_platforms
    if jax is None or not asked:
        return None
    try:
        jax.devices()
    except (RuntimeError, AssertionError) as error:
        reason = " ".join(str(error).split()) or "what JAX needs for it is not installed"
        return InputError(f"JAX_PLATFORMS: JAX can't use {asked} here; unset it, or set it to cpu ({reason})")
    return None
