"""Figure 12: planning sessions, plan by plan, with the recorded sequence whose last state was the goal."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes

from clothkit.cloth.mesh import best_label
from clothkit.cloth.symmetry import relabel, relabel_manipulation
from clothkit.cloth.topology import SQUARE
from clothkit.dataset.store import Dataset
from clothkit.dataset.tasks import Task
from clothkit.episodes.record import Sessions
from clothkit.manipulation.geometry import to_cartesian
from clothkit.report import panels
from clothkit.report.draw import draw

GAP = 0.14


class Step(NamedTuple):
    """One plan of a session for the m manipulations that are left [normalised], under the labels of its estimate."""

    estimate: Float[np.ndarray, "u v 3"]
    candidates: Float[np.ndarray, "points 2"]
    """Grasp point candidates in the estimate's xy."""
    plan: Float[np.ndarray, "m 6"]
    mean: Float[np.ndarray, "m u v 3"]
    std: Float[np.ndarray, "m u v 3"]
    refined: Float[np.ndarray, "u v 3"]
    """A plausible mesh of the predicted outcome; for illustration only."""
    executed: bool
    """Whether the plan's first manipulation was executed."""


class Session(NamedTuple):
    """The data of a picture of a session of n manipulations [normalised]."""

    task: Task
    recorded: Float[np.ndarray, "n+1 u v 3"]
    manipulations: Float[np.ndarray, "n 6"]
    states: Float[np.ndarray, "n+1 u v 3"]
    """The cloth's true states, from the start to the outcome."""
    steps: Sequence[Step]
    error: float
    error_no_action: float
    remark: str = ""
    """Why this session was chosen; empty for the first ones."""


def of_record(record: Sessions, dataset: Dataset, rows: pd.DataFrame, task: Task, *, net: int) -> Session | None:
    """A task's session from the record and the tidy rows of a system; None if the system did not plan for the task.

    `net` is the index of the net whose predictions are shown, if several nets made some.
    """
    found = (record.sequence == task.sequence) & (record.start == task.start) & (record.length == task.length)
    if not found.any():
        return None
    place, n, end = int(np.flatnonzero(found)[0]), task.length, task.start + task.length
    row = rows[(rows[list(Task._fields)] == list(task)).all(axis=1)].iloc[0]
    steps = []
    for step in range(n):
        estimate, uv = record.estimate[place, step], record.candidates[place, step]
        uv = uv[np.isfinite(uv).all(-1)]
        points = np.stack([np.asarray(to_cartesian(estimate, point))[:2] for point in uv])
        left, shown = n - step, min(net, record.prediction_mean.shape[3] - 1)
        mean, std = (
            values[place, step, :left, shown].astype(np.float32)
            for values in (record.prediction_mean, record.prediction_std)
        )
        refined = record.refined[place, step].astype(np.float32)
        plan, executed = record.plan[place, step, :left], not record.null[place, step]
        steps.append(Step(estimate, points, plan, mean, std, refined, executed))
    return Session(
        task,
        dataset.vertices[task.sequence, task.start : end + 1],
        dataset.manipulation[task.sequence, task.start : end],
        record.state[place, : n + 1],
        steps,
        float(row["error"]),
        float(row["error_no_action"]),
    )


def sessions(chosen: Sequence[Session], path: Path, *, per_row: int) -> None:
    """Writes a figure of sessions of one length, `per_row` of them side by side.

    The first row of a session shows the recorded sequence with the goal on light blue. The first column shows the true
    states, with the outcome on light blue. Each plan has a row with its estimate (E) and predictions (P), and in the
    last column a refined predicted outcome.
    """
    n = len(chosen[0].steps)
    block, height = n + 3, n + 2
    across = min(per_row, len(chosen))
    down = -(-len(chosen) // across)
    widths = ([1.0] * block + [GAP]) * across
    heights = ([1.0] * height + [GAP]) * down
    title = f"Planning in {n} step{'s' if n > 1 else ''} (error in cloth lengths)"
    figure, axes = panels.sheet(heights[:-1], widths[:-1], title=title, left=0.3)
    for number, session in enumerate(chosen):
        row, column = divmod(number, across)
        top, left = row * (height + 1), column * (block + 1)
        _session(session, axes[top : top + height, left : left + block])
    panels.save(figure, path)


def _session(session: Session, axes: np.ndarray) -> None:
    n = len(session.steps)
    _caption(session, axes[0, 0])
    for state, mesh in enumerate(session.recorded):
        axis = axes[0, 1 + state]
        panels.show(axis, drawn(mesh, goal=state == n), mark="R", note="goal" if state == n else "recorded")
        if state < n:
            panels.manipulate(axis, mesh, session.manipulations[state])
    for row, (step, real) in enumerate(zip(session.steps, session.states, strict=False), start=1):
        panels.show(axes[row, 0], draw(real), mark="R")
        shown = labelled(step, real)
        _plan(shown, axes[row, row:])
        panels.show(axes[row, -1], draw(shown.refined), mark="P", note="refined")
        panels.above(axes[row, row], f"plan #{row}")
    outcome = session.states[-1]
    panels.show(axes[n + 1, 0], drawn(outcome, goal=True), mark="R", note=f"{session.error:.3f}")


def _plan(step: Step, axes: np.ndarray) -> None:
    panels.show(axes[0], draw(step.estimate), mark="E", note="" if step.executed else "not executed")
    panels.candidates(axes[0], step.candidates)
    panels.manipulate(axes[0], step.estimate, step.plan[0])
    for i, (mean, std) in enumerate(zip(step.mean, step.std, strict=True), start=1):
        panels.show(axes[i], draw(mean, std=std), mark="P")
        if i < len(step.plan):
            panels.manipulate(axes[i], mean, step.plan[i])


def _caption(session: Session, axis: Axes) -> None:
    n = len(session.steps)
    remark = f"{session.remark}\n\n" if session.remark else ""
    text = (
        f"{remark}sequence {session.task.sequence}\nstate {session.task.start} to {session.task.start + n}\n\n"
        f"error {session.error:.3f}\nno action {session.error_no_action:.3f}\n\nwhat happened ↓"
    )
    axis.text(0.5, 0.02, text, transform=axis.transAxes, fontsize=7, ha="center", va="bottom", color=panels.INK)


def median(rows: pd.DataFrame, length: int) -> Task | None:
    """The test task of that length with the median error (the lower of two); None if there is no such task."""
    chosen = rows[(rows["split"] == "test") & (rows["length"] == length)]
    chosen = chosen.sort_values(["error", "sequence", "start"], kind="stable")
    if chosen.empty:
        return None
    row = chosen.iloc[(len(chosen) - 1) // 2]
    return Task(int(row["sequence"]), int(row["start"]), int(row["length"]))


def drawn(mesh: Float[np.ndarray, "u v 3"], *, goal: bool) -> np.ndarray:
    """A picture of the cloth from above, on light blue if `goal`, which is used for goals and final outcomes."""
    return draw(mesh, table=panels.GOAL) if goal else draw(mesh)


def _like(mesh: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, int]:
    """A mesh relabelled to match the truth, so that sides match in colour, and the index of the equivalent used."""
    k = int(SQUARE.inverses[int(best_label(mesh, truth))])
    return np.asarray(relabel(mesh, k)), k


def labelled(step: Step, truth: Float[np.ndarray, "u v 3"]) -> Step:
    """A plan relabelled so that its estimate matches the truth, and sides match in colour."""
    estimate, k = _like(step.estimate, truth)
    mean, std, refined = (np.asarray(relabel(a, k)) for a in (step.mean, step.std, step.refined))
    plan = np.asarray(relabel_manipulation(step.plan, k))
    return step._replace(estimate=estimate, plan=plan, mean=mean, std=std, refined=refined)
