"""The largest planning errors: what was there, what was wanted, seen and foreseen, and what came of it."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from clothkit.report import panels
from clothkit.report.draw import draw
from clothkit.report.figures.sessions import Session, drawn, labelled

HEADINGS = ("start, recorded", "goal", "estimate, first plan", "predicted outcome", "real outcome")

BESIDE = 0.4
"""Room between two examples, for the text of the second, as a share of a panel."""


class Failure(NamedTuple):
    """A session and what its first plan was wrong about; errors in cloth lengths, NaN where there is none."""

    session: Session
    estimate_error: float
    expected: float
    """The error that the nets expected of the first plan."""
    diagnosis: str


def largest(failures: Sequence[Failure], path: Path) -> None:
    """Two examples a row: start and recorded manipulation, goal, estimate and first plan, what it predicts, outcome.

    Meshes are drawn under labels that let sides of equal colour be the same side. Errors [cloth length] are those of
    the estimate, the expected one and the real one.
    """
    across = min(2, len(failures))
    block = [1.0] * len(HEADINGS)
    widths = [*block, BESIDE, *block] if across == 2 else block
    figure, axes = panels.sheet(
        [1.0] * -(-len(failures) // across),
        widths,
        title="Largest planning errors, test set, the largest first (errors in cloth lengths)",
        left=0.45,
        above=0.2,
    )
    for number, failure in enumerate(failures):
        row, column = divmod(number, across)
        shown = axes[row, column * (len(HEADINGS) + 1) :][: len(HEADINGS)]
        _failure(failure, shown)
        if row == 0:
            for axis, text in zip(shown, HEADINGS, strict=True):
                panels.heading(axis, text)
    panels.save(figure, path)


def _failure(failure: Failure, axes: np.ndarray) -> None:
    session = failure.session
    task, start = session.task, session.states[0]
    plan = labelled(session.steps[0], start)
    label = f"sequence {task.sequence}, state {task.start} to {task.start + task.length}\n{failure.diagnosis}"
    panels.row_label(axes[0], label)
    panels.show(axes[0], draw(start), mark="R")
    panels.manipulate(axes[0], start, session.manipulations[0])
    panels.show(axes[1], drawn(session.recorded[-1], goal=True), mark="R")
    panels.show(axes[2], draw(plan.estimate), mark="E", note=_error(failure.estimate_error))
    panels.candidates(axes[2], plan.candidates)
    panels.manipulate(axes[2], plan.estimate, plan.plan[0])
    panels.show(axes[3], draw(plan.mean[-1], std=plan.std[-1]), mark="P", note=_error(failure.expected))
    panels.show(axes[4], drawn(session.states[-1], goal=True), mark="R", note=_error(session.error))


def _error(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.3f}"
