"""Keeps dvc.lock beside the report that it re-derives, reports/<scale>/dvc.lock: `python stages/lock.py`."""

import re
import sys
from pathlib import Path

from ruamel.yaml import YAML

from clothkit.errors import system_error

LOCK = Path("dvc.lock")

OWN = re.compile(r"^  lock:\n(?:   .*\n)*", re.MULTILINE)
"""What a lock says of this stage: its name and the lines below it that are further in."""


def main() -> None:
    """Copy it but for this stage, which is not done yet: what stands there of it is an earlier run's."""
    # The scale alone: every stage before this one has read and checked the params.
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
