"""Figure 5: how grasp points and a displacement give release points, eq. (1)."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from clothkit.manipulation.geometry import release_points, to_cartesian
from clothkit.manipulation.vector import displacement, grasp_points, is_single
from clothkit.report import panels
from clothkit.report.draw import EXTENT, draw_silhouette

SIDE = 2.2
"""Side of a panel, as a share of the usual one."""

_BLUE, _QUIET, _OUTLINE = "#1f5fa8", "#777777", withStroke(linewidth=2.2, foreground="w")


class Example(NamedTuple):
    """A state and a manipulation of it."""

    mesh: Float[np.ndarray, "u v 3"]
    manipulation: Float[np.ndarray, "6"]


def trajectories(examples: Sequence[Example], path: Path) -> None:
    """Writes a figure with a panel per example: silhouette, displacement d from the middle of the grasp points, paths.

    For two hands, p and the line m of eq. (1) are drawn as well.
    """
    figure, axes = panels.sheet([SIDE], [SIDE] * len(examples), above=0.2)
    for axis, example in zip(axes[0], examples, strict=True):
        _example(axis, example)
    panels.save(figure, path)


def _example(axis: Axes, example: Example) -> None:
    single = bool(is_single(example.manipulation))
    panels.heading(axis, "one hand" if single else "two hands")
    panels.show(axis, draw_silhouette(example.mesh))
    moved = np.asarray(displacement(example.manipulation))
    grasps = np.stack([np.asarray(to_cartesian(example.mesh, uv))[:2] for uv in grasp_points(example.manipulation)])
    releases = np.asarray(release_points(grasps, moved).points)
    middle = grasps.mean(axis=0)
    if not single:
        across = np.array([-moved[1], moved[0]]) / np.linalg.norm(moved)
        p = middle + moved / 2
        line = np.stack([p - 4 * EXTENT * across, p + 4 * EXTENT * across]).T
        axis.plot(*line, color=_QUIET, linewidth=0.8, linestyle=(0, (5, 3)))
        axis.plot(*grasps.T, color=_QUIET, linewidth=0.8)
        axis.plot(*p, "o", color=_QUIET, markersize=3.5)
        _name(axis, p, "p", moved + across * np.linalg.norm(moved))
        _name(axis, p + 0.45 * EXTENT * across, "m", moved)
        tip = panels.clipped(middle, middle + moved)[-1]
        axis.annotate("", tip, middle, arrowprops={"arrowstyle": "->", "color": _QUIET, "linewidth": 1.1})
        _name(axis, tip, "d", np.array([moved[1], -moved[0]]))
    for number, (grasp, release) in enumerate(zip(grasps, releases, strict=True), start=1):
        path = panels.clipped(grasp, release)
        if len(path):
            axis.plot(*path.T, color=_BLUE, linewidth=1.6)
            panels.end(axis, path, release, colour=_BLUE)
            _name(axis, path[1], f"r{number}", release - grasp)
        axis.plot(*grasp, "o", markersize=5, markerfacecolor="white", markeredgecolor=_BLUE, markeredgewidth=1.3)
        _name(axis, grasp, f"g{number}", grasp - release)
        if single:
            break


def _name(axis: Axes, point: np.ndarray, text: str, away: np.ndarray) -> None:
    """Writes a name beside a point, on the side to which `away` points, inside the panel."""
    x, y = np.clip(point + 0.1 * away / max(float(np.linalg.norm(away)), 1e-9), -0.93 * EXTENT, 0.93 * EXTENT)
    axis.text(x, y, text, fontsize=8, color=panels.INK, ha="center", va="center", path_effects=[_OUTLINE])
