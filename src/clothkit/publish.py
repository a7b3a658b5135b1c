"""Files and folders come to their places as a whole: a kill at any moment leaves the old one or the new one."""

import contextlib
import errno
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from clothkit.errors import system_error

ARRIVING, REPLACED = ".arriving", ".replaced"
"""Endings of the hidden names beside an output under which the new one arrives and the old one waits for it."""


@contextlib.contextmanager
def alone(lock: Path) -> Iterator[None]:
    """Wait until no other process publishes. The lock is the kernel's: a kill frees it. Raises InputError."""
    try:
        lock.parent.mkdir(parents=True, exist_ok=True)
        file = lock.open("w")
    except OSError as error:
        raise system_error(error, lock, action="opened") from error
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def publish(source: Path, target: Path) -> None:
    """Move a finished file or folder to its place, replacing what was there.

    The source may lie on another file system: it is brought beside the target first and written through to the disk.
    Then the old output is set aside by renaming, the new one is renamed in, and only then the old one is deleted. Of a
    kill between the two renamings `recover` mends the absence. Raises InputError when something can't be written; then
    target and source are what they were.
    """
    arriving, replaced = _beside(target, ARRIVING), _beside(target, REPLACED)
    recover(target)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        _bring(source, arriving)
        _sync(arriving)
        if _is_folder(target) or (_is_folder(arriving) and os.path.lexists(target)):
            os.rename(target, replaced)
        os.replace(arriving, target)
    except BaseException as error:
        with contextlib.suppress(OSError):
            if not os.path.lexists(source):
                os.rename(arriving, source)
        with contextlib.suppress(OSError):
            _restore(target)
        if isinstance(error, FileExistsError):
            # A file where a folder is expected on the way to the target.
            raise system_error(error, error.filename, action="written") from error
        if isinstance(error, OSError):
            raise system_error(error, target, action="written") from error
        raise
    try:
        _sync_folder(target.parent)
        _delete(replaced)
        _delete(source)
    except OSError as error:
        raise system_error(error, error.filename or replaced, action="written") from error


def recover(target: Path) -> None:
    """Put an output back that a killed `publish` had set aside, and delete what it left. Raises InputError."""
    try:
        _restore(target)
    except OSError as error:
        raise system_error(error, error.filename or target, action="written") from error


def leftovers(folders: Iterable[Path]) -> list[Path]:
    """The outputs under some folders beside which a killed `publish` has left something."""
    left = [
        (path, ending) for folder in folders for ending in (ARRIVING, REPLACED) for path in folder.rglob(f".*{ending}")
    ]
    return sorted({path.with_name(path.name[1 : -len(ending)]) for path, ending in left})


@contextlib.contextmanager
def unfinished(path: Path) -> Iterator[Path]:
    """A name to write a single file under, which becomes `path` if all goes well.

    Raises InputError when it can't be written; then what was there is as it was.
    """
    # Short, because a name as long as names may be has no room for more.
    part = path.with_name(f".part{os.getpid()}{path.suffix}")
    try:
        yield part
        part.replace(path)
    except OSError as error:
        raise system_error(error, path, action="written") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


@contextlib.contextmanager
def unfinished_files(folder: Path) -> Iterator[Path]:
    """A folder to write files into, which come into `folder`, made when it isn't there, if all goes well.

    Raises InputError when they can't be written. Until all of them are, what was there is as it was.
    """
    made: list[Path] = []
    try:
        made += [path for path in (folder, *folder.parents) if not path.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".part", dir=folder) as part:
            yield Path(part)
            for file in sorted(Path(part).iterdir()):
                file.replace(folder / file.name)
    except BaseException as error:
        named = folder if os.path.isdir(folder) or not isinstance(error, OSError) else error.filename or folder
        for path in made:
            with contextlib.suppress(OSError):
                path.rmdir()
        if isinstance(error, OSError):
            raise system_error(error, named, action="written") from error
        raise


def _beside(target: Path, ending: str) -> Path:
    return target.with_name(f".{target.name}{ending}")


def _restore(target: Path) -> None:
    replaced = _beside(target, REPLACED)
    if os.path.lexists(replaced) and not os.path.lexists(target):
        os.rename(replaced, target)
    _delete(replaced)
    _delete(_beside(target, ARRIVING))


def _bring(source: Path, arriving: Path) -> None:
    try:
        os.rename(source, arriving)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        _copy(source, arriving)


def _copy(source: Path, target: Path) -> None:
    """Contents alone: some file systems take no permissions or times."""
    if not source.is_dir():
        shutil.copyfile(source, target)
        return
    target.mkdir()
    for path in source.iterdir():
        _copy(path, target / path.name)


def _sync(path: Path) -> None:
    if path.is_dir():
        for child in path.iterdir():
            _sync(child)
        _sync_folder(path)
        return
    with path.open("rb") as file:
        os.fsync(file)


def _sync_folder(path: Path) -> None:
    # Not every file system can.
    with contextlib.suppress(OSError):
        number = os.open(path, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def _is_folder(path: Path) -> bool:
    """Whether it is a folder itself: a link to one is replaced, and what it leads to is left alone."""
    return path.is_dir() and not path.is_symlink()


def _delete(path: Path) -> None:
    if _is_folder(path):
        shutil.rmtree(path)
    elif os.path.lexists(path):
        path.unlink()
