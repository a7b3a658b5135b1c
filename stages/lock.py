"""Keeps dvc.lock beside the report that it re-derives, reports/<scale>/dvc.lock: `python stages/lock.py`."""

import sys
from pathlib import Path

from ruamel.yaml import YAML

from clothkit.errors import InputError, system_error
from clothkit.params import load_params

LOCK = Path("dvc.lock")


def main() -> None:
    """Copy it but for this stage, which is not done yet: what stands there of it is an earlier run's."""
    try:
        copy = Path("reports") / load_params(Path("params.yaml")).scale / LOCK.name
    except InputError as error:
        sys.exit(f"lock: {error}")
    yaml = YAML()
    try:
        lock = yaml.load(LOCK)
    except OSError as error:
        sys.exit(f"lock: {system_error(error, LOCK, expected='what dvc repro writes')}")
    lock["stages"].pop("lock", None)
    try:
        yaml.dump(lock, copy)
    except OSError as error:
        sys.exit(f"lock: {system_error(error, copy, action='written')}")


if __name__ == "__main__":
    main()
