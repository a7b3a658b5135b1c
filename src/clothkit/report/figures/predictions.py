"""Figure 10: predictions of the forward model below the recorded states."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from clothkit.dataset.store import Dataset
from clothkit.report import panels
from clothkit.report.draw import draw


def predictions(
    dataset: Dataset, found: Mapping[str, np.ndarray], rows: pd.DataFrame, path: Path, *, count: int
) -> None:
    """Writes a figure with two examples side by side: the recorded sequence above, the predicted one below.

    Examples are the first `count` test sequences. Predictions are those of the main system's best net, from an
    estimate of the first state. Errors [cloth length] of 1, 2 and 3 steps are from the tidy rows. Lilac shows sigma,
    the yellow arrow the predicted shift of the centre.
    """
    test = set(dataset.indices("test").tolist())
    places = [place for place, sequence in enumerate(found["sequence"]) if int(sequence) in test][:count]
    figure, axes = panels.sheet(
        [1.0] * (2 * -(-len(places) // 2)),
        panels.PAIR,
        title="Predictions, test set (error in cloth lengths)",
        left=0.3,
    )
    chosen = rows[rows["better"] & (rows["system"] == "main") & (rows["start"] == 0)]
    errors = chosen.set_index(["sequence", "length"])["error"]
    for number, place in enumerate(places):
        row, first = 2 * (number // 2), 5 * (number % 2)
        sequence = int(found["sequence"][place])
        if not first:
            panels.row_label(axes[row, 0], "recorded")
            panels.row_label(axes[row + 1, 0], "predicted")
        length = int(dataset.length[sequence])
        for state in range(length + 1):
            recorded, foreseen = axes[row, first + state], axes[row + 1, first + state]
            truth = dataset.vertices[sequence, state]
            panels.show(recorded, draw(truth), mark="R")
            if state == 0:
                mesh = found["start"][place]
                panels.show(foreseen, draw(mesh), mark="E")
            else:
                mesh, std = found["mean"][place, state - 1], found["std"][place, state - 1]
                panels.show(foreseen, draw(mesh, std=std), mark="P", note=f"{errors[sequence, state]:.3f}")
                panels.centre_shift(foreseen, found["shift"][place, state - 1], mesh)
            if state < length:
                manipulation = dataset.manipulation[sequence, state]
                panels.manipulate(recorded, truth, manipulation)
                panels.manipulate(foreseen, mesh, manipulation)
    panels.save(figure, path)
