"""The number of manipulations on the command line: told, or chosen by what each number is expected to come to."""

from typing import Any, Literal

import click
import numpy as np

from clothkit.dataset.store import STEPS
from clothkit.planning.systems import System
from clothkit.planning.types import Choice
from clothkit.runtime.errors import InputError

AUTO: Literal["auto"] = "auto"


class Steps(click.ParamType):
    """An option's value: a number of manipulations, 1 to STEPS, or AUTO."""

    name = "steps"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int | str:
        if value == AUTO:
            return AUTO
        try:
            number = int(value)
        except ValueError:
            number = 0
        if not 1 <= number <= STEPS:
            self.fail(f"expected 1 to {STEPS} or {AUTO}, found {value}", param, ctx)
        return number


def check_can_choose(system: System) -> None:
    """Check that a system can choose the number of manipulations. Raises InputError."""
    if system.voxels:
        raise InputError(
            f"--steps {AUTO}: system {system.name} plans in voxels, whose distance tells too little of a shape; "
            f"expected a number, 1 to {STEPS}"
        )


def choice_in_words(choice: Choice, side: float) -> str:
    """Return a line on what each number of manipulations is expected to come to, for a cloth of that side [m]."""
    chosen, expected = int(choice.length[0]), choice.expected[0]
    counts = [
        f"{number}: {1000 * side * value:.0f} mm{' (chosen)' if number == chosen else ''}"
        for number, value in enumerate(expected.tolist())
        if np.isfinite(value)
    ]
    line = f"expected error by number of manipulations: {', '.join(counts)}"
    if chosen:
        return line
    # One manipulation has no margin to earn: it was left out for what plans with such expectations came to.
    worse = expected[1] < expected[0]
    why = ": plans with such expectations ended farther from their goals than the cloth lies now" if worse else ""
    return f"{line}; nothing more is worth doing{why}"
