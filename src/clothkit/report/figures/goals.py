"""Named goals: how each is folded, and what plans for them came to."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from clothkit.cloth.silhouette import centred
from clothkit.goals.settings import SOURCE_NAMES, START_NAMES, SYSTEM_OF
from clothkit.manipulation.named_folds import GOALS
from clothkit.report import panels
from clothkit.report.draw import draw, draw_heights
from clothkit.report.panels import GOAL


class Folded(NamedTuple):
    """How a goal is folded."""

    name: str
    states: Float[np.ndarray, "states u v 3"]
    """The flat cloth and the cloth after each manipulation [normalised]."""
    manipulations: Float[np.ndarray, "steps 6"]


def goals(folded: Sequence[Folded], path: Path, *, columns: int = 2) -> None:
    """Writes a figure with a row per goal, `columns` of them side by side: the cloth before each fold, and the goal."""
    columns = min(columns, len(folded))
    rows = -(-len(folded) // columns)
    most = [
        max(len(one.states) for one in folded[column * rows : (column + 1) * rows] or folded[:1])
        for column in range(columns)
    ]
    widths = [width for states in most for width in ([1.0] * states + [0.35])][:-1]
    heights = [height for _ in range(rows) for height in (0.12, 1.0)]
    figure, axes = panels.sheet(heights, widths, left=0.1)
    starts = np.cumsum([0, *(states + 1 for states in most)])
    for number, one in enumerate(folded):
        column, row = divmod(number, rows)
        line = axes[2 * row + 1, starts[column] :]
        count = len(one.manipulations)
        words = f"{one.name}: {count} manipulation{'' if count == 1 else 's'}"
        line[0].text(0, 1.03, words, transform=line[0].transAxes, fontsize=7.5, color=panels.INK, va="bottom")
        for step, state in enumerate(one.states):
            mesh = centred(state)[0]
            last = step == count
            panels.show(line[step], draw(mesh, table=GOAL if last else (1.0, 1.0, 1.0)))
            if not last:
                panels.manipulate(line[step], mesh, one.manipulations[step])
    panels.save(figure, path)


def goal_seen(voxels: Bool[np.ndarray, "x y z"], mesh: Float[np.ndarray, "u v 3"] | None, path: Path) -> None:
    """Writes a picture of the heights that were seen of a goal, and of the mesh that it is taken for, if it is one."""
    pictures = {"seen, by height": draw_heights(voxels)}
    if mesh is not None:
        pictures["taken for"] = draw(centred(mesh.astype(np.float32))[0], table=GOAL)
    figure, axes = panels.sheet([0.12, 2.0], [2.0] * len(pictures))
    for axis, (title, picture) in zip(axes[1], pictures.items(), strict=True):
        panels.show(axis, picture)
        axis.text(0, 1.02, title, transform=axis.transAxes, fontsize=8, color=panels.INK, va="bottom")
    panels.save(figure, path)


def goal_outcomes(pictures: Mapping[str, np.ndarray], path: Path) -> None:
    """Writes a figure with a row per goal: the goal, and by start the cloth at first and what each source came to."""
    rows = list(dict.fromkeys(pictures["goal"].tolist()))
    begins = sorted(set(pictures["begins"].tolist()))
    shown = {start: sorted(set(pictures["source"][pictures["begins"] == start].tolist())) for start in begins}
    widths = [1.0]
    for start in begins:
        widths += [0.14, 1.0, *[1.0] * len(shown[start])]
    figure, axes = panels.sheet([1.0] * len(rows), widths, left=0.3, above=0.2)
    panels.heading(axes[0, 0], "goal")
    for row, goal in enumerate(rows):
        panels.row_label(axes[row, 0], list(GOALS)[goal])
        column = 2
        for start in begins:
            for place, source in enumerate(shown[start]):
                chosen = (pictures["goal"] == goal) & (pictures["begins"] == start) & (pictures["source"] == source)
                if row == 0:
                    panels.heading(axes[0, column + 1 + place], _heading(source))
                for example in np.flatnonzero(chosen):
                    panels.show(axes[row, 0], draw(pictures["target"][example], table=GOAL))
                    panels.show(axes[row, column], draw(pictures["start"][example]))
                    panels.show(axes[row, column + 1 + place], draw(pictures["outcome"][example], table=GOAL))
            if row == 0:
                panels.heading(axes[0, column], START_NAMES[start])
            column += 2 + len(shown[start])
    panels.save(figure, path)


def _heading(source: int) -> str:
    name = SOURCE_NAMES[source]
    return f"{SYSTEM_OF[name]}, {name}" if name in SYSTEM_OF else name
