"""Replace output files and folders as a whole: a kill at any moment leaves a complete old or new one."""

import contextlib
import errno
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from clothkit.runtime.errors import system_error

ARRIVING, REPLACED = ".arriving", ".replaced"
"""Suffixes of the hidden names beside an output: of the new one before it is renamed in, and of the old one after."""


@contextlib.contextmanager
def alone(lock: Path) -> Iterator[None]:
    """Hold an exclusive lock on a file, after waiting for other processes to release it.

    The kernel releases the lock of a killed process. Raises InputError if the file can't be opened.
    """
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

    The source may lie on another file system: it is first moved or copied beside the target and synced to disk. Then
    the old output is renamed aside, the new one is renamed to `target`, and the old one is deleted. (If both are files,
    one rename replaces the old one.) After a kill between the two renames the target is missing; `recover` puts the old
    output back. Raises InputError when something can't be written; target and source are then unchanged, unless only
    the final deletion failed.
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
            # There is a file at the place of one of the target's parent folders.
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
    """Put back an output that a killed `publish` had renamed aside, and delete its hidden files. Raises InputError."""
    try:
        _restore(target)
    except OSError as error:
        raise system_error(error, error.filename or target, action="written") from error


def leftovers(folders: Iterable[Path]) -> list[Path]:
    """The outputs under `folders` beside which there are hidden files of an interrupted or running `publish`."""
    left = [
        (path, ending) for folder in folders for ending in (ARRIVING, REPLACED) for path in folder.rglob(f".*{ending}")
    ]
    return sorted({path.with_name(path.name[1 : -len(ending)]) for path, ending in left})


@contextlib.contextmanager
def unfinished(path: Path) -> Iterator[Path]:
    """Yield a temporary name for a single file, and rename that file to `path` if the block succeeds.

    Raises InputError when the file can't be written; what was at `path` is then unchanged.
    """
    # The name is not derived from `path.name`, which may already have the maximal length.
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
    """Copy contents only: some file systems do not accept permissions or times."""
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
    # Not every file system can sync a folder.
    with contextlib.suppress(OSError):
        number = os.open(path, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def _is_folder(path: Path) -> bool:
    """Whether `path` is a folder and not a link to one: a link is replaced, and the folder behind it is left alone."""
    return path.is_dir() and not path.is_symlink()


def _delete(path: Path) -> None:
    if _is_folder(path):
        shutil.rmtree(path)
    elif os.path.lexists(path):
        path.unlink()
