"""Recorded sequences of the toy world (tests/planning/toy.py)."""

import jax.numpy as jnp
import numpy as np

from clothkit.cloth.silhouette import centred
from clothkit.dataset.store import SPLITS, Dataset, papers_cloths
from tests.planning import toy

MANIPULATIONS = np.array([[-1, -1, -1, -1, 0.6, 0.5], [1, 1, 1, 1, -0.7, -0.3], [-1, 1, -1, 1, 0.5, -0.6]], np.float32)


def dataset(sequences: int = 2) -> Dataset:
    """Test sequences of three manipulations each, all but the first with the cloth elsewhere on the table."""
    vertices, centres = [], []
    for s in range(sequences):
        state = toy.bent() + np.array([0.3 * s, -0.2 * s, 0], np.float32)
        states = [centred(state)]
        for manipulation in MANIPULATIONS:
            state = np.asarray(toy.dragged(jnp.asarray(state), jnp.asarray(manipulation)))
            states.append(centred(state))
        vertices.append([mesh for mesh, _ in states])
        centres.append([middle for _, middle in states])
    every = np.ones(sequences, np.int8)
    return Dataset(
        np.array(vertices, np.float32),
        np.array(centres, np.float32),
        np.repeat(MANIPULATIONS[None], sequences, axis=0),
        np.ones((sequences, 3), np.int8),
        3 * every,
        np.full(sequences, SPLITS.index("test"), np.int8),
        every.astype(bool),
        *papers_cloths(sequences),
    )
