"""Copies dvc.lock to the report that it can re-derive, reports/<scale>/dvc.lock: `python stages/lock.py`."""

import re
import sys
from pathlib import Path

from ruamel.yaml import YAML

from clothkit.runtime.errors import system_error

LOCK = Path("dvc.lock")

OWN = re.compile(r"^  lock:\n(?:   .*\n)*", re.MULTILINE)
"""Matches this stage's own entry in the lock: its name and the more indented lines below it."""


def main() -> None:
    """Copy the lock without this stage's own entry, which is an earlier run's while this stage is running."""
    # Only the scale is read: the stages before this one have read and checked the params.
    copy = Path("reports") / YAML(typ="safe").load(Path("params.yaml"))["scale"] / LOCK.name
    try:
        whole = LOCK.read_text()
    except OSError as error:
        sys.exit(f"lock: {system_error(error, LOCK, expected='what dvc repro writes')}")
    try:
        copy.write_text(OWN.sub("", whole))
    except OSError as error:
        sys.exit(f"lock: {system_error(error, copy, action='written')}")


if __name__ == "__main__":
    main()
