"""JSON files that hold one object, read in one place: whatever else a file is, is told in one sentence."""

import json
from pathlib import Path
from typing import Any

from clothkit.runtime.errors import InputError, system_error


def read_json(path: Path, *, expected: str) -> dict[str, Any]:
    """The object in a JSON file; `expected` tells what it should be, in messages.

    Raises InputError for a file that can't be read, is truncated or no JSON, holds something else than an object, or
    has a key twice, of which readers take one or the other.
    """
    try:
        return parse_json(path, path.read_bytes(), expected=expected)
    except OSError as error:
        raise system_error(error, path, expected=expected) from error


def parse_json(path: Path, content: bytes, *, expected: str) -> dict[str, Any]:
    """The object that a file's content is, as `read_json`."""
    try:
        found = json.loads(content, object_pairs_hook=_once)
    except _TwiceError as error:
        raise InputError(f"{path}: expected {expected}, found key {error} twice") from error
    except (ValueError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else " ".join(str(error).split())
        raise InputError(f"{path}: expected {expected}, found a truncated or damaged file ({reason})") from error
    if not isinstance(found, dict):
        raise InputError(f"{path}: expected {expected}, found no JSON object but {json.dumps(found):.40}")
    return found


class _TwiceError(Exception):
    """A key that stands in an object twice."""


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        raise _TwiceError(json.dumps(next(name for name in names if names.count(name) > 1))[:60])
    return found
