"""Figure 7: the Cartesian equivalents, meshes that describe one shape; the square has eight."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from clothkit.cloth.symmetry import equivalents as equivalents_of
from clothkit.cloth.topology import SQUARE, Topology
from clothkit.report import panels
from clothkit.report.draw import EXTENT, draw

SIDE = 1.35
"""Side of a panel, as a share of the usual one."""

NEAR = 0.25
"""Distance of corners below which they share one text [normalised]."""


def equivalents(mesh: Float[np.ndarray, "u v 3"], path: Path, topology: Topology = SQUARE) -> None:
    """Writes a figure of the shape under each labelling, coloured by geodesic coordinates; corners are labelled."""
    rows = 2 if topology.count > 1 else 1
    figure, axes = panels.sheet([SIDE] * rows, [SIDE] * (topology.count // rows))
    for axis, labelled in zip(axes.flat, np.asarray(equivalents_of(mesh, topology)), strict=True):
        panels.show(axis, draw(labelled, texture="geodesic"))
        _corners(axis, labelled)
    panels.save(figure, path)


def _corners(axis: Axes, mesh: Float[np.ndarray, "u v 3"]) -> None:
    """Writes the geodesic coordinates of the corners beside them, in one text where corners coincide."""
    together: list[tuple[list[np.ndarray], list[str]]] = []
    for u, v in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
        corner = mesh[u, v, :2]
        text = "({}, {})".format(*("1" if last else "−1" for last in (u, v)))
        group = next((group for group in together if np.linalg.norm(group[0][0] - corner) < NEAR), None)
        if group is None:
            together.append(([corner], [text]))
        else:
            group[0].append(corner)
            group[1].append(text)
    middle = mesh[..., :2].reshape(-1, 2).mean(axis=0)
    for corners, names in together:
        outmost = max(corners, key=lambda corner: float(np.linalg.norm(corner - middle)))
        away = (outmost - middle) / max(float(np.linalg.norm(outmost - middle)), 1e-9)
        x, y = np.clip(outmost + (0.12 + 0.05 * len(names)) * away, -0.86 * EXTENT, 0.86 * EXTENT)
        axis.text(
            x,
            y,
            "\n".join(names),
            fontsize=6.5,
            color=panels.INK,
            ha="center",
            va="center",
            path_effects=[withStroke(linewidth=2.2, foreground="w")],
        )
