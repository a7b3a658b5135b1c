"""Write output files as a whole or not at all, check targets beforehand, and print progress."""

import contextlib
import os
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import click
import numpy as np
from jaxtyping import Float

from clothkit.cloth.topology import geodesic, triangles
from clothkit.dataset.export import Surface, encode
from clothkit.runtime.errors import InputError, system_error
from clothkit.runtime.publish import unfinished

_ERASE = "\r\x1b[K"


@contextlib.contextmanager
def part(what: str) -> Iterator[None]:
    """Print on stderr how long a block took and, on a terminal, its name `what` while it runs."""
    started, terminal = time.monotonic(), sys.stderr.isatty()
    if terminal:
        click.echo(f"{what} ..", nl=False, err=True)
    try:
        yield
    except BaseException:
        # The error message must start on a line of its own.
        click.echo(_ERASE if terminal else "", nl=False, err=True)
        raise
    click.echo(f"{_ERASE if terminal else ''}{what}: {time.monotonic() - started:.1f} s", err=True)


def check_target(path: Path, endings: tuple[str, ...]) -> None:
    """Check, before any work is done, that a file with one of `endings` can be written to `path`. Raises InputError."""
    if path.suffix.lower()[1:] not in endings:
        raise InputError(f"{path}: ending {path.suffix!r}, expected {' or '.join(endings)}")
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder, expected a file to write")
        if not path.parent.is_dir():
            raise InputError(f"{path}: {path.parent} is no folder, it must be there")
        # Raises OSError if the name is too long or the folder is not accessible.
        path.lstat()
    except FileNotFoundError:
        pass
    except OSError as error:
        raise system_error(error, path, action="written") from error
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: can't be written, {path.parent} is write-protected")


def write_mesh(path: Path, vertices: Float[np.ndarray, "u v 3"]) -> None:
    """Write a mesh [m, z up] as OBJ, PLY or GLB, by the file's ending. Raises InputError."""
    shape = vertices.shape[:2]
    uv = (geodesic(shape).reshape(-1, 2) + 1) / 2
    surface = Surface(0, 0, vertices.reshape(-1, 3).astype(np.float32), triangles(shape), uv, path.stem)
    with unfinished(path) as part:
        part.write_bytes(encode(surface, path.suffix.lower()[1:]))


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write named arrays as NPZ. Raises InputError."""
    with unfinished(path) as part, part.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
