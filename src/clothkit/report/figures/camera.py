"""Depth cameras' pictures of a cloth, with voxels and estimates from them (section 6.5)."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes

from clothkit.cloth import voxels
from clothkit.cloth.mesh import best_label
from clothkit.cloth.symmetry import relabel
from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import Viewport
from clothkit.dataset.store import Dataset
from clothkit.evaluation.camera_settings import UNMEASURED
from clothkit.report import panels
from clothkit.report.draw import draw, draw_heights, grey_of_height, relief_colours

ROWS = ("height above the table", "voxels", "estimate, refined")
HIGHEST = 0.03
"""Height with the darkest colour [m]; greater heights have the same colour."""
_BAR = 0.09
"""Height of the scales, as a share of a panel."""
_SHOWN = 0.8
"""Side of the part that is shown, as a share of the image's shorter side."""
_MISSING = np.array([0.95, 0.62, 0.60], np.float32)


def camera(
    dataset: Dataset,
    pictures: Mapping[str, np.ndarray],
    estimates: Mapping[str, np.ndarray],
    conditions: list[str],
    path: Path,
    *,
    viewport: Viewport,
) -> None:
    """Writes a figure with a block per example: a column without a camera, then a column per condition.

    The rows of a block show heights (without a camera the true mesh), voxels, and the refined estimate. `viewport` is
    that of the pictures' voxels.
    """
    count = len(pictures["sequence"])
    heights = [*([1.0] * 3 + [0.12]) * count, _BAR, 0.12]
    figure, axes = panels.sheet(heights, [1.0] * (1 + len(conditions)), left=0.3, above=0.2)
    for column, name in enumerate(["no camera", *conditions]):
        panels.heading(axes[0, column], name)
    for number, (sequence, state) in enumerate(zip(pictures["sequence"], pictures["shown"], strict=True)):
        rows = axes[4 * number : 4 * number + 3]
        for axis, text in zip(rows[:, 0], ROWS, strict=True):
            panels.row_label(axis, text)
        truth = dataset.vertices[sequence, state]
        place = int(np.flatnonzero(estimates["sequence"] == sequence)[0])
        panels.show(rows[0, 0], draw(truth), mark="R")
        panels.show(rows[1, 0], draw_heights(np.asarray(voxels.observe(truth, viewport=viewport))))
        panels.show(rows[2, 0], draw(labelled(estimates["mesh"][place, state], truth)), mark="E")
        for column in range(len(conditions)):
            panels.show(rows[0, 1 + column], relief(pictures["height"][number, column]))
            panels.show(rows[1, 1 + column], draw_heights(pictures["voxels"][number, column]))
            panels.show(rows[2, 1 + column], draw(labelled(pictures["mesh"][number, column], truth)), mark="E")
    _scales(axes[-2])
    panels.save(figure, path)


def _scales(axes: np.ndarray) -> None:
    """Draws the colour scales of the pictures: heights for the first row of a block, voxels for the second."""
    share = np.linspace(0, 1, 128, dtype=np.float32)[None]
    ticks = [0.0, 10.0, 20.0, 1e3 * HIGHEST]
    _bar(axes[0], relief_colours(share), ticks, "height [mm]; red: not measured", more=True)
    layers = voxels.RESOLUTION[2]
    steps = np.repeat(grey_of_height(np.arange(1, layers + 1) / layers)[None, :, None], 3, axis=-1)
    if len(axes) > 1:
        _bar(axes[1], steps, [1.0, layers / 2, float(layers)], "highest voxel of a column", low=0.5, high=layers + 0.5)


def _bar(
    axis: Axes,
    colours: Float[np.ndarray, "1 n 3"],
    ticks: Sequence[float],
    text: str,
    *,
    low: float = 0.0,
    high: float | None = None,
    more: bool = False,
) -> None:
    """Draws a horizontal scale from `low` to `high` (None: the last tick). With `more`, the last tick is labelled ≥."""
    axis.set_axis_on()
    axis.imshow(colours, extent=(low, ticks[-1] if high is None else high, 0, 1), aspect="auto", interpolation="none")
    labels = [f"{tick:g}" for tick in ticks]
    axis.set_xticks(ticks, [*labels[:-1], f"≥ {labels[-1]}" if more else labels[-1]], fontsize=6)
    # Labels at the ends stay within their scale, because scales are side by side.
    first, *_, last = axis.get_xticklabels()
    first.set_horizontalalignment("left")
    last.set_horizontalalignment("right")
    axis.set_yticks([])
    axis.tick_params(length=2, pad=1.5)
    axis.set_xlabel(text, fontsize=6.5, labelpad=1)
    for spine in axis.spines.values():
        spine.set(color="#cccccc", linewidth=0.6)


def labelled(mesh: Float[np.ndarray, "u v 3"], truth: Float[np.ndarray, "u v 3"]) -> Float[np.ndarray, "u v 3"]:
    """A mesh relabelled to match the truth, so that the same side of the cloth has the same colour in both."""
    return np.asarray(relabel(mesh, int(SQUARE.inverses[int(best_label(mesh, truth))])))


def relief(heights: Float[np.ndarray, "row column"]) -> UInt8[np.ndarray, "side side 3"]:
    """The middle of a height image [m] in `relief_colours`; red where nothing was measured."""
    rows, columns = heights.shape
    half = int(_SHOWN * min(rows, columns)) // 2
    middle = heights[rows // 2 - half : rows // 2 + half, columns // 2 - half : columns // 2 + half]
    image = relief_colours(np.clip(middle / HIGHEST, 0, 1))
    image = np.where((middle == UNMEASURED)[..., None], _MISSING, image)
    return np.rint(image * 255).astype(np.uint8)
