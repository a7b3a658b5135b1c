"""Kills a resumable map at each of its file events; each next run finishes it and computes no stored piece again.

A program of its own, for it forks: `python tests/killed_pieces.py FOLDER file` (or `folder`, the form of its pieces).
Prints how many events there were.
"""

import os
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path

from tqdm import tqdm

from clothkit.runtime.resumable import Storage, resumable_map

KEYS = ("a", "b", "c")


def save_file(path: Path, value: str) -> None:
    path.write_text(value)


def save_folder(path: Path, value: str) -> None:
    path.mkdir()
    for half, part in enumerate((value[:2], value[2:])):
        (path / str(half)).write_text(part)


def load_folder(path: Path) -> str:
    return "".join((path / str(half)).read_text() for half in range(2))


STORAGES = {"file": Storage(save_file, Path.read_text, suffix=".txt"), "folder": Storage(save_folder, load_folder)}


def mapped(folder: Path, form: str, compute: Callable[[str], str]) -> list[str]:
    with tqdm(total=len(KEYS), disable=True) as bar:
        storage = STORAGES[form]
        pieces = resumable_map(compute, KEYS, folder=folder, name="p", storage=storage, bar=bar, count=len)
        return [piece.value for piece in pieces]


def leaving(key: str, place: str) -> str:
    """A piece; the first process that is asked for the last one is killed. All that are asked for are noted down."""
    with open(f"{place}/asked", "a") as file:
        file.write(f"{key}\n")
    marker = Path(place) / "killed"
    if key == KEYS[-1] and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return f"piece {key}"


def killed(folder: Path, form: str, event: int) -> bool:
    """Whether a map, in a process of its own, came as far as that event and was killed there."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 0
    count = 0

    def hook(name: str, arguments: object) -> None:
        nonlocal count
        count += name == "open" or name.startswith(("os.", "shutil."))
        if count == event:
            os._exit(9)

    sys.addaudithook(hook)
    mapped(folder, form, "first {}".format)
    os._exit(0)


def main(folder: Path, form: str) -> None:
    event, going = 0, True
    while going:
        event += 1
        shutil.rmtree(folder, ignore_errors=True)
        going = killed(folder, form, event)
        stored = len(list(folder.glob(f"p_*[0-9]{STORAGES[form].suffix}")))
        found = mapped(folder, form, "second {}".format)
        assert found == [f"{'first' if place < stored else 'second'} {key}" for place, key in enumerate(KEYS)], event
        assert mapped(folder, form, "third {}".format) == found
        assert len(list(folder.iterdir())) == len(KEYS), list(folder.iterdir())
        assert going or stored == len(KEYS)
    print(event - 1)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
