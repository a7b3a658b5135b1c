"""Datasets of crumpled cloths that are small enough to train on in a test."""

import numpy as np

from clothkit.cloth.topology import SQUARE
from clothkit.dataset.store import Dataset, papers_cloths


def crumpled(count: int, seed: int) -> Dataset:
    """Sequences of three manipulations; every state is the one before with random waves added."""
    rng = np.random.default_rng(seed)
    uv = np.linspace(0, 1, SQUARE.shape[0], dtype=np.float32)
    u, v = np.meshgrid(uv, uv, indexing="ij")
    vertices = np.broadcast_to(SQUARE.flat(), (count, 4, *SQUARE.shape, 3)).copy()
    for state in range(1, 4):
        waves = rng.normal(0, 0.1, (count, 3, 1, 1)) * u + rng.normal(0, 0.1, (count, 3, 1, 1)) * np.sin(3 * v)
        moved = vertices[:, state - 1] + np.moveaxis(waves, 1, -1)
        moved[..., 2] = np.abs(moved[..., 2]) / 3
        vertices[:, state] = moved - [1, 1, 0] * moved.mean((1, 2), keepdims=True)
    return Dataset(
        vertices=vertices.astype(np.float32),
        centre=rng.normal(0, 0.1, (count, 4, 2)).astype(np.float32),
        manipulation=rng.uniform(-1, 1, (count, 3, 6)).astype(np.float32),
        hands=np.full((count, 3), 2, np.int8),
        length=np.full(count, 3, np.int8),
        split=np.zeros(count, np.int8),
        evaluated=np.zeros(count, bool),
        **papers_cloths(count)._asdict(),
    )
