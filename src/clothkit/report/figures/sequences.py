"""Pictures of simulated sequences, as examples of the data."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from clothkit.dataset.store import Dataset
from clothkit.report import panels
from clothkit.report.draw import draw


class Strip(NamedTuple):
    """One sequence in a picture: centred meshes [normalised] and the manipulations between them."""

    meshes: Sequence[Float[np.ndarray, "u v 3"]]
    manipulations: Sequence[Float[np.ndarray, "6"]]
    label: str = ""


def sequences(dataset: Dataset, path: Path, *, count: int) -> None:
    """Writes a figure of the first `count` evaluated test sequences, with up to four states and their manipulations."""
    chosen = dataset.of_split("test", evaluated=True)
    strips = [
        Strip(list(chosen.vertices[place, : length + 1]), list(chosen.manipulation[place, :length]))
        for place, length in enumerate(chosen.length[:count])
    ]
    draw_strips(
        strips,
        path,
        title="Simulated test sequences: states, manipulations and heights (normalised; the flat cloth is 1.4 wide)",
    )


def draw_strips(strips: Sequence[Strip], path: Path, *, title: str) -> None:
    """Writes a figure of sequences of up to four states, two per row, with their heights and manipulations."""
    left = 0.25 if any(strip.label for strip in strips) else 0.1
    figure, axes = panels.sheet([1.0] * -(-len(strips) // 2), panels.PAIR, title=title, left=left)
    for place, strip in enumerate(strips):
        row, block = divmod(place, 2)
        panels.row_label(axes[row, 5 * block], strip.label)
        for state, mesh in enumerate(strip.meshes):
            axis = axes[row, 5 * block + state]
            panels.show(axis, draw(mesh), note=f"{np.nanmax(mesh[..., 2]):.3f}" if state else "")
            if state < len(strip.manipulations):
                panels.manipulate(axis, mesh, strip.manipulations[state])
    panels.save(figure, path)
