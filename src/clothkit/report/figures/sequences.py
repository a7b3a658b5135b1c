"""A sheet of simulated sequences: what the data look like."""

from pathlib import Path

import numpy as np

from clothkit.dataset.store import STEPS, Dataset
from clothkit.report import panels
from clothkit.report.draw import draw


def sequences(dataset: Dataset, path: Path, *, count: int) -> None:
    """The first `count` evaluated test sequences, four states each with the manipulations between them, two a row."""
    chosen = dataset.of_split("test", evaluated=True)
    count = min(count, len(chosen))
    figure, axes = panels.sheet(
        [1.0] * -(-count // 2),
        panels.PAIR,
        title="Simulated test sequences: states, manipulations and heights (normalised; the flat cloth is 1.4 wide)",
    )
    for place in range(count):
        row, block = divmod(place, 2)
        for state in range(chosen.length[place] + 1):
            axis, mesh = axes[row, 5 * block + state], chosen.vertices[place, state]
            panels.show(axis, draw(mesh), note=f"{np.nanmax(mesh[..., 2]):.3f}" if state else "")
            if state < min(STEPS, chosen.length[place]):
                panels.manipulate(axis, mesh, chosen.manipulation[place, state])
    panels.save(figure, path)
