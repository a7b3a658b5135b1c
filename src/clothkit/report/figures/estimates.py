"""Figure 9: estimates of shapes from voxels, before and after refinement."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from clothkit.cloth import voxels
from clothkit.cloth.symmetry import relabel
from clothkit.cloth.voxels import Viewport
from clothkit.dataset.store import Dataset
from clothkit.report import panels
from clothkit.report.draw import draw, draw_heights

ROWS = ("truth", "voxels from above", "estimate (mean, σ lilac)", "refined")


def estimates(
    dataset: Dataset,
    found: Mapping[str, np.ndarray],
    rows: pd.DataFrame,
    path: Path,
    *,
    count: int,
    viewport: Viewport,
) -> None:
    """Writes a figure with a column per example: truth, voxels as height map, VtM's mean with its sigma, refined mesh.

    Examples are states of the first `count` test sequences after one, two or three manipulations. Voxels are those of
    VtM's `viewport`, errors [cloth length] from the tidy rows. Meshes have the labels of the truth, so that the same
    side has the same colour.
    """
    test = set(dataset.indices("test").tolist())
    places = [place for place, sequence in enumerate(found["sequence"]) if int(sequence) in test][:count]
    longest = dataset.length[found["sequence"][places]]
    states = np.minimum(np.sort(np.arange(len(places)) % 3 + 1), longest)
    figure, axes = panels.sheet(
        [1.0] * 4, [1.0] * len(places), title="Estimates, test set (error in cloth lengths)", left=0.3
    )
    for axis, text in zip(axes[:, 0], ROWS, strict=True):
        panels.row_label(axis, text)
    errors = rows.set_index(["sequence", "state", "kind"])["error"]
    for column, (place, state) in enumerate(zip(places, states, strict=True)):
        sequence = int(found["sequence"][place])
        truth, label = dataset.vertices[sequence, state], int(found["label"][place, state])
        mean, std, mesh = (np.asarray(relabel(found[name][place, state], label)) for name in ("mean", "std", "mesh"))
        panels.show(axes[0, column], draw(truth), mark="R")
        panels.show(axes[1, column], draw_heights(np.asarray(voxels.observe(truth, viewport=viewport))))
        panels.show(axes[2, column], draw(mean, std=std), mark="E", note=f"{errors[sequence, state, 'pmr']:.3f}")
        panels.show(axes[3, column], draw(mesh), mark="E", note=f"{errors[sequence, state, 'dmr']:.3f}")
    panels.save(figure, path)
