"""Figures of small pictures with manipulations, grasp candidates and marks drawn on them, and of charts."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from clothkit.manipulation.geometry import release_points, to_cartesian
from clothkit.manipulation.vector import displacement, grasp_points, is_null, is_single
from clothkit.report.draw import EXTENT

PANEL = 1.5
"""Side of a panel [inch]."""

SPACE = 0.06
"""Space between panels, as a share of their side."""

PAIR = [1.0] * 4 + [0.14] + [1.0] * 4
"""Relative widths of the columns for two sequences side by side, four states each."""

DOTS = 130
"""Pixels per inch of a saved figure."""

GOAL = (0.86, 0.93, 1.0)
"""Background of goals and final outcomes."""

_HANDS = ("#c62828", "#2e7d32")
_CANDIDATE = "#8e5bd0"
INK = "#333333"
"""Colour of text."""


def sheet(
    heights: Sequence[float], widths: Sequence[float], *, title: str = "", left: float = 0.1, above: float = 0.0
) -> tuple[Figure, np.ndarray]:
    """A figure and its axes [rows columns], which are invisible until `show` draws on them.

    `heights` of rows and `widths` of columns are in panels; a narrow row or column separates blocks. `left` [inch] is
    the room for row labels, `above` [inch] the room for headings.
    """
    width, height = (PANEL * (sum(shares) + SPACE * (len(shares) - 1)) for shares in (widths, heights))
    top = (0.35 if title else 0.1) + above
    # A title needs this width even above a single column.
    total_width, total_height = max(left + width + 0.1, 4.5 if title else 0), top + height + 0.1
    figure = Figure(figsize=(total_width, total_height))
    FigureCanvasAgg(figure)
    axes: np.ndarray = np.empty((len(heights), len(widths)), dtype=object)
    for i, j in np.ndindex(*axes.shape):
        x = left + PANEL * (sum(widths[:j]) + SPACE * j)
        y = top + PANEL * (sum(heights[:i]) + SPACE * i)
        box = (x, total_height - y - PANEL * heights[i], PANEL * widths[j], PANEL * heights[i])
        axis = figure.add_axes(tuple(np.array(box) / np.array([total_width, total_height] * 2)))
        axis.set_axis_off()
        axes[i, j] = axis
    if title:
        figure.text(0.1 / total_width, 1 - 0.2 / total_height, title, fontsize=9, color=INK, va="center")
    return figure, axes


def chart(count: int, *, width: float, height: float = 2.6, columns: int = 0) -> tuple[Figure, list[Axes]]:
    """A figure of `count` charts with light axes, `columns` (0: all) side by side, each `width` x `height` [inch]."""
    columns = columns or count
    rows = -(-count // columns)
    figure = Figure(figsize=(width * columns + 0.6, height * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes = [figure.add_subplot(rows, columns, i + 1) for i in range(count)]
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(labelsize=7.5)
        axis.grid(color="#eeeeee", linewidth=0.6)
        axis.set_axisbelow(True)
    return figure, axes


def label_ends(axis: Axes, ends: Sequence[tuple[float, str, str]], *, least: float = 0.075) -> None:
    """Writes a text to the right of a chart for each line, near the height where the line ends.

    `ends`: height [data], text and colour of each. `least` is the least distance between texts as a share of the
    chart's height. The chart's limits must be final.
    """
    to_share = axis.transData + axis.transAxes.inverted()
    ordered = sorted(ends)
    shares = [float(to_share.transform((0, height))[1]) for height, _, _ in ordered]
    # Texts are pushed apart upwards and downwards; the mean of both positions keeps the least distance.
    up, down = shares.copy(), shares.copy()
    for i in range(1, len(shares)):
        up[i] = max(up[i], up[i - 1] + least)
        down[-1 - i] = min(down[-1 - i], down[-i] - least)
    for share, low, high, (_, text, colour) in zip(shares, down, up, ordered, strict=True):
        axis.annotate(
            text,
            (1, share),
            xycoords="axes fraction",
            xytext=(1.035, (low + high) / 2),
            textcoords="axes fraction",
            fontsize=7.5,
            color=colour,
            va="center",
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.5, "shrinkA": 0, "shrinkB": 0},
        )


def show(axis: Axes, picture: UInt8[np.ndarray, "row column 3"], *, mark: str = "", note: str = "") -> None:
    """Shows a picture of `draw` on a panel, with texts at the bottom.

    `mark` (R real, E estimate, P prediction) is on the left, `note` on the right.
    """
    axis.set_axis_on()
    axis.imshow(picture, extent=(-EXTENT, EXTENT, -EXTENT, EXTENT), interpolation="none")
    axis.set(xlim=(-EXTENT, EXTENT), ylim=(-EXTENT, EXTENT), xticks=[], yticks=[])
    for spine in axis.spines.values():
        spine.set(color="#cccccc", linewidth=0.6)
    # Texts have an outline so that they stay legible above paths of hands.
    style: dict = {
        "transform": axis.transAxes,
        "color": INK,
        "path_effects": [withStroke(linewidth=2.2, foreground="w")],
    }
    if mark:
        axis.text(0.035, 0.035, mark, fontsize=7, fontweight="bold", **style)
    if note:
        axis.text(0.965, 0.035, note, fontsize=6.5, ha="right", **style)


def row_label(axis: Axes, text: str) -> None:
    """Writes text left of a panel, rotated to read upwards."""
    axis.text(
        -0.08, 0.5, text, transform=axis.transAxes, rotation=90, fontsize=7.5, color=INK, ha="center", va="center"
    )


def above(axis: Axes, text: str) -> None:
    """Writes text in a panel's upper left corner."""
    axis.text(0.03, 0.97, text, transform=axis.transAxes, fontsize=6.5, va="top", color=INK)


def heading(axis: Axes, text: str) -> None:
    """Writes text above a panel."""
    axis.text(0.5, 1.03, text, transform=axis.transAxes, fontsize=7.5, color=INK, ha="center", va="bottom")


def manipulate(axis: Axes, mesh: Float[np.ndarray, "u v 3"], manipulation: Float[np.ndarray, "6"]) -> None:
    """Draws the hands' paths over a mesh, dotted in red and green, or a text for a null manipulation.

    Paths begin at circled grasp points and end in crosses at release points. A path whose release point lies outside
    the panel ends in an arrow at the panel's border.
    """
    if bool(is_null(manipulation)):
        axis.text(0.5, 0.11, "no action", transform=axis.transAxes, fontsize=7, color=INK, ha="center", va="bottom")
        return
    grasps = np.stack([np.asarray(to_cartesian(mesh, uv))[:2] for uv in grasp_points(manipulation)])
    releases = np.asarray(release_points(grasps, np.asarray(displacement(manipulation))).points)
    hands = 1 if bool(is_single(manipulation)) else 2
    for grasp, release, colour in list(zip(grasps, releases, _HANDS, strict=True))[:hands]:
        path = clipped(grasp, release)
        if len(path):
            axis.plot(*path.T, color="white", linewidth=2.2, alpha=0.75, solid_capstyle="round")
            axis.plot(*path.T, color=colour, linewidth=1.4, linestyle=(0, (1.2, 1.0)))
            end(axis, path, release, colour=colour)
        axis.plot(*grasp, "o", markersize=3.6, markerfacecolor="white", markeredgecolor=colour, markeredgewidth=1.2)


def end(axis: Axes, path: Float[np.ndarray, "2 2"], release: Float[np.ndarray, "2"], *, colour: str) -> None:
    """Draws the end of a path [end xy]: a cross at the release point, or an arrow at the border if it lies outside."""
    if np.allclose(path[1], release):
        axis.plot(*release, marker="x", markersize=4.2, markeredgecolor=colour, markeredgewidth=1.4)
        return
    along = path[1] - path[0]
    tail = path[1] - along * min(1.0, 0.12 * EXTENT / max(float(np.linalg.norm(along)), 1e-9))
    style = {"arrowstyle": "-|>,head_width=0.22,head_length=0.42", "color": colour, "linewidth": 0.8, "shrinkB": 0}
    axis.annotate("", path[1], tail, arrowprops={**style, "shrinkA": 0}, annotation_clip=False)


def clipped(start: Float[np.ndarray, "2"], stop: Float[np.ndarray, "2"]) -> Float[np.ndarray, "ends 2"]:
    """The ends [2 xy] of the part of the line from start to stop inside -EXTENT..EXTENT; [0 xy] if all is outside."""
    direction = stop - start
    first, last = 0.0, 1.0
    for place, along in zip(start, direction, strict=True):
        if along == 0:
            if abs(place) > EXTENT:
                return np.zeros((0, 2))
            continue
        low, high = sorted(((-EXTENT - place) / along, (EXTENT - place) / along))
        first, last = max(first, float(low)), min(last, float(high))
    return np.stack([start + first * direction, start + last * direction]) if first < last else np.zeros((0, 2))


def candidates(axis: Axes, points: Float[np.ndarray, "points 2"]) -> None:
    """Draws grasp point candidates as lilac circles."""
    axis.plot(*points.T, "o", markersize=6.5, markerfacecolor="none", markeredgecolor=_CANDIDATE, markeredgewidth=1.0)


def centre_shift(axis: Axes, shift: Float[np.ndarray, "2"], mesh: Float[np.ndarray, "u v 3"]) -> None:
    """Draws the predicted shift of the cloth's centre, to scale, as a yellow arrow in the panel's emptiest corner.

    The arrow lies beside the cloth so that it hides no fold. A shift too short for an arrow is drawn as a dot.
    """
    length = float(np.linalg.norm(shift))
    half = np.abs(shift) / 2
    middles = np.array([[x, y] for y in (1, -1) for x in (-1, 1)]) * (EXTENT - _CORNER - half)
    # The lower corners hold marks and notes, so they are used only if the cloth leaves no room in the upper ones.
    room = [_distance(mesh[..., :2], middle, shift) - (0.15 if middle[1] < 0 else 0.0) for middle in middles]
    middle = middles[int(np.argmax(room))]
    outline = [withStroke(linewidth=2.8, foreground="#5a4a00")]
    if length < 0.04:
        axis.plot(*middle, "o", markersize=3.2, color="#ffe600", path_effects=outline)
        return
    arrow = {"arrowstyle": "->,head_width=0.16,head_length=0.3", "color": "#ffe600", "linewidth": 1.5}
    arrow |= {"shrinkA": 0, "shrinkB": 0, "path_effects": outline}
    axis.annotate("", middle + shift / 2, middle - shift / 2, arrowprops=arrow)


_CORNER = 0.1
"""Distance between a panel's border and the arrow in its corner [normalised]."""


def _distance(points: np.ndarray, middle: np.ndarray, shift: np.ndarray) -> float:
    """The distance from the arrow to the nearest vertex [normalised]."""
    line = middle + np.linspace(-0.5, 0.5, 9)[:, None] * shift
    return float(np.linalg.norm(points.reshape(-1, 1, 2) - line, axis=-1).min())


def save(figure: Figure, path: Path) -> None:
    """Writes the figure as PNG, without date and version, so that the same figure gives the same bytes."""
    figure.savefig(path, dpi=DOTS, format="png", metadata={"Software": None})
