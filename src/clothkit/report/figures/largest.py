"""Sessions with the largest planning errors: start, goal, estimates, plans, predictions and outcomes."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from clothkit.report import panels
from clothkit.report.draw import draw
from clothkit.report.figures.sessions import GAP, Session, drawn, labelled

HEADINGS = ("start, recorded", "goal", "estimate, plan", "predicted outcome", "what happened")

BESIDE = 0.4
"""Room between two examples, for the text of the second, as a share of a panel."""


class Failure(NamedTuple):
    """A session and the errors of its first plan, with a diagnosis. Errors are in cloth lengths, NaN if missing."""

    session: Session
    estimate_error: float
    expected: float
    """The error of the first plan according to the nets."""
    diagnosis: str


def largest(failures: Sequence[Failure], path: Path) -> None:
    """Writes a figure with two examples side by side and a row for every plan of a session.

    At the left are the start with the recorded manipulation, and the goal. Then follow, for each plan, the estimate
    with the plan's first manipulation, the outcome that is predicted for the whole plan, and the state after execution;
    the final outcome is on light blue. Meshes are relabelled so that the same side has the same colour. Errors [cloth
    length] are those of the first estimate, of the first plan as expected, and of the outcome.
    """
    across = min(2, len(failures))
    block = [1.0] * len(HEADINGS)
    widths = [*block, BESIDE, *block] if across == 2 else block
    pairs = [failures[first : first + across] for first in range(0, len(failures), across)]
    plans = [max(len(failure.session.steps) for failure in pair) for pair in pairs]
    heights = [height for count in plans for height in ([1.0] * count + [GAP])][:-1]
    figure, axes = panels.sheet(
        heights,
        widths,
        title="Largest planning errors, test set, the largest first (errors in cloth lengths)",
        left=0.45,
        above=0.2,
    )
    top = 0
    for pair, count in zip(pairs, plans, strict=True):
        for column, failure in enumerate(pair):
            shown = axes[top : top + count, column * (len(HEADINGS) + 1) :][:, : len(HEADINGS)]
            _failure(failure, shown)
            if top == 0:
                for axis, text in zip(shown[0], HEADINGS, strict=True):
                    panels.heading(axis, text)
        top += count + 1
    panels.save(figure, path)


def _failure(failure: Failure, axes: np.ndarray) -> None:
    session = failure.session
    task, start, last = session.task, session.states[0], len(session.steps) - 1
    label = f"sequence {task.sequence}, state {task.start} to {task.start + task.length}\n{failure.diagnosis}"
    panels.row_label(axes[0, 0], label)
    panels.show(axes[0, 0], draw(start), mark="R")
    panels.manipulate(axes[0, 0], start, session.manipulations[0])
    panels.show(axes[0, 1], drawn(session.recorded[-1], goal=True), mark="R")
    for number, step in enumerate(session.steps):
        row, plan = axes[number], labelled(step, session.states[number])
        first, final = number == 0, number == last
        panels.show(row[2], draw(plan.estimate), mark="E", note=_error(failure.estimate_error) if first else "")
        panels.above(row[2], f"plan #{number + 1}" + ("" if step.executed else ", not executed"))
        panels.candidates(row[2], plan.candidates)
        panels.manipulate(row[2], plan.estimate, plan.plan[0])
        note = _error(failure.expected) if first else ""
        panels.show(row[3], draw(plan.mean[-1], std=plan.std[-1]), mark="P", note=note)
        note = _error(session.error) if final else ""
        panels.show(row[4], drawn(session.states[number + 1], goal=final), mark="R", note=note)


def _error(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.3f}"
