"""Before a plan: what a goal is taken for, shown and confirmed."""

import sys
from pathlib import Path

import click

from clothkit.app.agreement import EstimateAgreement
from clothkit.app.inputs import Input
from clothkit.app.planner import State
from clothkit.cloth.voxels import RESOLUTION
from clothkit.report.figures.goals import goal_seen
from clothkit.runtime.publish import unfinished

ENDING = ".goal.png"


def asks(goal: Input, agreement: EstimateAgreement | None) -> bool:
    """Return whether to ask if a goal is right where nobody said so: it is estimated from what a camera saw, and there
    is a terminal to ask on. Without one, a notice on stderr names the option.

    `agreement` is that of its estimate with what was seen; None: it was not estimated.
    """
    if agreement is None or goal.kind != "points":
        return False
    if on_terminal():
        return True
    click.echo(f"notice: {goal.file}: what it is taken for is not confirmed (--confirm shows it, and asks)", err=True)
    return False


def on_terminal() -> bool:
    """Return whether a person can answer."""
    return sys.stdin.isatty()


def confirm_goal(out: Path, goal: Input, target: State, agreement: EstimateAgreement | None) -> None:
    """Draw a goal as it was seen and as the system takes it, into a picture beside `out`, and ask if that is right.

    `agreement` is that of its estimate with what was seen; None: it was not estimated. Raises click.Abort,
    which ends a command, if it is not the goal.
    """
    path = out.with_suffix(ENDING)
    with unfinished(path) as part:
        goal_seen(goal.observation.voxels, None if target.shape == RESOLUTION else target, part)
    click.echo(f"{path}: the goal as it was seen, and what it is taken for", err=True)
    if agreement is not None:
        click.echo(agreement.sentence, err=True)
    click.confirm("Is this the goal?", abort=True, err=True)
