"""Checkpoints, from which an interrupted training resumes: one file, which is replaced atomically."""

import json
import os
from pathlib import Path
from typing import Any

import jax
import numpy as np
from flax import serialization
from jaxtyping import PyTree

from clothkit.runtime.errors import damaged_piece


def write(path: Path, arrays: PyTree, notes: Any) -> None:
    """Write a pytree of arrays, and notes that can be converted to JSON.

    The file is replaced atomically: if the process is killed, either the old or the new file is there.
    """
    leaves = {str(i): np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(arrays))}
    half_written = path.with_suffix(".new")
    half_written.write_bytes(serialization.msgpack_serialize({"leaves": leaves, "notes": json.dumps(notes)}))
    os.replace(half_written, path)


def read(path: Path, like: PyTree) -> tuple[PyTree, Any]:
    """The arrays, nested like `like`, and the notes. Raises InputError when the file is damaged."""
    try:
        stored = serialization.msgpack_restore(path.read_bytes())
        leaves = [stored["leaves"][str(i)] for i in range(len(stored["leaves"]))]
        return jax.tree.unflatten(jax.tree.structure(like), leaves), json.loads(stored["notes"])
    except Exception as error:  # msgpack has a dozen ways to say that bytes are missing
        raise damaged_piece(error, path) from error
