"""What depth cameras show of a cloth, and the estimates that come of it (section 6.5)."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from clothkit.cloth import voxels
from clothkit.cloth.equivalents import INVERSE, relabel
from clothkit.cloth.mesh import best_label
from clothkit.dataset.store import Dataset
from clothkit.evaluation.camera_settings import UNMEASURED
from clothkit.report import panels
from clothkit.report.draw import draw, draw_heights, relief_colours

ROWS = ("height above the table", "voxels", "estimate, refined")
HIGHEST = 0.03
"""Darkest [m]."""
_SHOWN = 0.8
"""Of the image's shorter side."""
_MISSING = np.array([0.95, 0.62, 0.60], np.float32)


def camera(
    dataset: Dataset,
    pictures: Mapping[str, np.ndarray],
    estimates: Mapping[str, np.ndarray],
    conditions: list[str],
    path: Path,
) -> None:
    """A block per example: a column for the truth with its noise-free voxels and estimate, then one per condition."""
    count = len(pictures["sequence"])
    heights = ([1.0] * 3 + [0.12]) * count
    figure, axes = panels.sheet(heights[:-1], [1.0] * (1 + len(conditions)), left=0.3, above=0.2)
    for column, name in enumerate(["no camera", *conditions]):
        panels.heading(axes[0, column], name)
    for number, (sequence, state) in enumerate(zip(pictures["sequence"], pictures["shown"], strict=True)):
        rows = axes[4 * number : 4 * number + 3]
        for axis, text in zip(rows[:, 0], ROWS, strict=True):
            panels.row_label(axis, text)
        truth = dataset.vertices[sequence, state]
        place = int(np.flatnonzero(estimates["sequence"] == sequence)[0])
        panels.show(rows[0, 0], draw(truth), mark="R")
        panels.show(rows[1, 0], draw_heights(np.asarray(voxels.observe(truth))))
        panels.show(rows[2, 0], draw(labelled(estimates["mesh"][place, state], truth)), mark="E")
        for column in range(len(conditions)):
            panels.show(rows[0, 1 + column], relief(pictures["height"][number, column]))
            panels.show(rows[1, 1 + column], draw_heights(pictures["voxels"][number, column]))
            panels.show(rows[2, 1 + column], draw(labelled(pictures["mesh"][number, column], truth)), mark="E")
    panels.save(figure, path)


def labelled(mesh: Float[np.ndarray, "u v 3"], truth: Float[np.ndarray, "u v 3"]) -> Float[np.ndarray, "u v 3"]:
    """A mesh under the labels of the truth, so that sides of equal colour are the same side."""
    return np.asarray(relabel(mesh, int(INVERSE[int(best_label(mesh, truth))])))


def relief(heights: Float[np.ndarray, "row column"]) -> UInt8[np.ndarray, "side side 3"]:
    """The middle of a picture, coloured by height [m] as `draw_relief` is; red where nothing was measured."""
    rows, columns = heights.shape
    half = int(_SHOWN * min(rows, columns)) // 2
    middle = heights[rows // 2 - half : rows // 2 + half, columns // 2 - half : columns // 2 + half]
    image = relief_colours(np.clip(middle / HIGHEST, 0, 1))
    image = np.where((middle == UNMEASURED)[..., None], _MISSING, image)
    return np.rint(image * 255).astype(np.uint8)
