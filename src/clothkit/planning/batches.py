"""Batches of a fixed size, so that a jitted function is compiled once for any number of examples."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

BATCH = 24
"""Batch size of cheap functions of any number of states, which would else be compiled for every number there is."""


def in_batches(function: Callable[..., Any], size: int, *trees: Any) -> Any:
    """Apply `function` to batches of `size` examples; return the concatenated outputs as a pytree of NumPy arrays.

    `trees` are pytrees of arrays whose leading axis counts the examples; so are the outputs of `function`. The last
    batch is padded with copies of the last example; the outputs of the copies are dropped.
    """
    count = len(jax.tree.leaves(trees)[0])
    parts = []
    for first in range(0, count, size):
        index = np.minimum(np.arange(first, first + size), count - 1)
        found = function(*jax.tree.map(lambda leaf, index=index: leaf[index], trees))
        kept = min(size, count - first)
        parts.append(jax.tree.map(lambda leaf, kept=kept: np.asarray(leaf)[:kept], found))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


def take(tree: Any, rows: Any) -> Any:
    """The given rows of every array of a pytree."""
    return jax.tree.map(lambda leaf: leaf[rows], tree)
