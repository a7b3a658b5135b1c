"""What came of a loader or a command, so that it can be compared, and what lies in a folder."""

import dataclasses
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pydantic


def tree(folder: Path) -> dict[str, str]:
    """What lies in a folder: a digest of each file by its path; links are not followed."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            found[name] = f"-> {os.readlink(path)}"
        else:
            found[name] = "folder" if path.is_dir() else hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def digest(value: Any) -> str:
    """Equal for equal results."""
    found = hashlib.sha256()
    for name, leaf in _leaves(value):
        found.update(f"{name} ".encode())
        if isinstance(leaf, np.ndarray):
            found.update(f"{leaf.dtype} {leaf.shape}".encode())
            found.update(repr(leaf.tolist()).encode() if leaf.dtype == object else leaf.tobytes())
        else:
            found.update(repr(leaf).encode())
    return found.hexdigest()


def wildest(value: Any) -> str:
    """The first part of a result that holds infinity or absurd numbers; empty if there is none."""
    for name, leaf in _leaves(value):
        numbers = np.asarray(leaf)
        if numbers.dtype.kind != "f" or not numbers.size:
            continue
        known = numbers[~np.isnan(numbers)]
        if np.isinf(known).any() or np.abs(known, dtype=float).max(initial=0) > 1e12:
            return f"{name} holds {np.abs(known, dtype=float).max()}"
    return ""


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Numbers, words and arrays of a result, with their places."""
    if isinstance(value, pydantic.BaseModel):
        value = value.model_dump()
    elif isinstance(value, pd.DataFrame):
        value = {column: value[column].to_numpy() for column in value}
    elif dataclasses.is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    elif hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _leaves(part, f"{name}.{key}")
    elif isinstance(value, list | tuple):
        for place, part in enumerate(value):
            yield from _leaves(part, f"{name}.{place}")
    elif isinstance(value, np.ndarray) and value.dtype == object:
        for place, part in enumerate(value.ravel()):
            yield from _leaves(part if isinstance(part, np.ndarray) else [part], f"{name}.{place}")
    elif hasattr(value, "shape"):
        yield name, np.asarray(value)
    else:
        yield name, value
