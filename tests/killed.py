"""What becomes of an output when publishing is killed, or refused a file, at each of its file events.

A program of its own, for it forks: `python tests/killed.py WORK DATA die` (or `fail`), with the folders of source and
target. Prints how many events there were.
"""

import errno
import os
import shutil
import sys
from pathlib import Path

from clothkit.runtime.errors import InputError
from clothkit.runtime.publish import leftovers, publish, recover

CONTENTS: dict[str, dict[str, bytes] | bytes | None] = {
    "nothing": None,
    "old file": b"old" * 1000,
    "old folder": {"zarr.json": b"{}", "c/0": b"old" * 1000, "c/1": b"old"},
    "new file": b"new" * 2000,
    "new folder": {"zarr.json": b"{1}", "c/0": b"new" * 2000, "d/2/3": b"new"},
}
CASES = [
    ("old folder", "new folder"),
    ("old file", "new file"),
    ("nothing", "new folder"),
    ("old folder", "new file"),
    ("old file", "new folder"),
]


def write(path: Path, name: str) -> None:
    contents = CONTENTS[name]
    shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    for file, data in ({"": contents} if not isinstance(contents, dict) else contents).items():
        if data is not None:
            (path / file).parent.mkdir(parents=True, exist_ok=True)
            (path / file).write_bytes(data)


def name_of(path: Path) -> str:
    """Which of the contents a path has, "partial" if none of them."""
    found: dict[str, bytes] | bytes | None = None
    if path.is_dir():
        found = {str(p.relative_to(path)): p.read_bytes() for p in path.rglob("*") if p.is_file()}
    elif path.exists():
        found = path.read_bytes()
    return next((name for name, contents in CONTENTS.items() if contents == found), "partial")


def interrupted(source: Path, target: Path, event: int, how: str) -> bool:
    """Whether publishing, in a process of its own, came as far as that event, which it did not survive."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 0
    seen = 0

    def hook(name: str, arguments: object) -> None:
        nonlocal seen
        seen += name == "open" or name.startswith(("os.", "shutil."))
        if seen == event and how == "die":
            os._exit(9)
        if seen == event:
            seen += 1  # What mends the failure is not failed itself.
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    sys.addaudithook(hook)
    try:
        publish(source, target)
    except InputError as error:
        os._exit(1 if "no space is left" in str(error) else 0)
    os._exit(0 if seen < event else 1)


def main(work: Path, data: Path, how: str) -> None:
    source, target = work / "out", data / "out"
    events = 0
    for old, new in CASES:
        event, going = 0, True
        while going:
            event += 1
            write(source, new)
            write(target, old)
            going = interrupted(source, target, event, how)
            if how == "fail" and going and name_of(target) != new:
                assert (name_of(target), name_of(source)) == (old, new), (old, new, event)
            if name_of(target) == "nothing" != old:
                assert leftovers([data]) == [target]
                recover(target)
                assert name_of(target) == old, (old, new, event)
            assert name_of(target) in (old, new), (old, new, event, name_of(target))
            assert going or name_of(target) == new
            # The next run makes the output anew from its pieces.
            write(source, new)
            publish(source, target)
            assert name_of(target) == new
            assert sorted(data.iterdir()) == [target], list(data.iterdir())
            assert not source.exists()
        events += event
    print(events)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3])
