"""Batches of one size: a program that is compiled for it serves any number of examples."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np


def in_batches(function: Callable[..., Any], size: int, *trees: Any) -> Any:
    """What `function` gives for pytrees of arrays with a leading axis of examples, `size` of them at a time, as NumPy.

    The last batch is filled up with copies of the last example.
    """
    count = len(jax.tree.leaves(trees)[0])
    parts = []
    for first in range(0, count, size):
        index = np.minimum(np.arange(first, first + size), count - 1)
        found = function(*jax.tree.map(lambda leaf, index=index: leaf[index], trees))
        kept = min(size, count - first)
        parts.append(jax.tree.map(lambda leaf, kept=kept: np.asarray(leaf)[:kept], found))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
