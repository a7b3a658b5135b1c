"""Figures 2 and 3: one state as a mesh and as a probabilistic mesh, with their components over the cloth."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from clothkit.report import panels
from clothkit.report.draw import draw

COMPONENTS = ("x", "y", "z")

SIDE, GAP = 1.15, 0.08
"""Side of a panel, and distance between blocks, as shares of the usual panel."""


def meshes(
    truth: Float[np.ndarray, "u v 3"], mean: Float[np.ndarray, "u v 3"], std: Float[np.ndarray, "u v 3"], path: Path
) -> None:
    """Writes a figure with two rows. First row: the mesh from above with a grid texture, and its x, y, z in greys.

    Second row: an estimate of it, its means, and its standard deviations. Grey images have u to the right and v upwards
    [normalised]; lighter is greater. Greys span -1..1 for x and y, the mesh's own heights for z, and 0 to the largest
    value for each standard deviation.
    """
    block = [SIDE] * len(COMPONENTS)
    figure, axes = panels.sheet([SIDE, GAP, SIDE], [SIDE, GAP, *block, GAP, *block], left=0.3, above=0.2)
    # The narrow row in between is room for the second row's headings.
    axes = axes[::2]
    panels.row_label(axes[0, 0], "mesh")
    panels.row_label(axes[1, 0], "probabilistic mesh")
    panels.show(axes[0, 0], draw(truth, texture="grid"))
    panels.show(axes[1, 0], draw(mean, std=std, texture="grid"))
    highest = max(float(truth[..., 2].max()), 1e-3)
    for place, name in enumerate(COMPONENTS):
        low, high = (-1.0, 1.0) if place < 2 else (0.0, highest)
        _greys(axes[0, 2 + place], truth[..., place], low, high)
        _greys(axes[1, 2 + place], mean[..., place], low, high)
        panels.heading(axes[0, 2 + place], name)
        panels.heading(axes[1, 2 + place], f"μ {name}")
        sigma = std[..., place]
        _greys(axes[1, 6 + place], sigma, 0.0, float(sigma.max()))
        panels.heading(axes[1, 6 + place], f"σ {name}: up to {sigma.max():.3f}")
    panels.save(figure, path)


def _greys(axis: Axes, values: Float[np.ndarray, "u v"], low: float, high: float) -> None:
    axis.set_axis_on()
    axis.imshow(values.T, origin="lower", cmap="gray", vmin=low, vmax=high, interpolation="none")
    axis.set(xticks=[], yticks=[])
    for spine in axis.spines.values():
        spine.set(color="#cccccc", linewidth=0.6)
