"""What to do about an estimate that may be wrong, or a plan that may not come true: a sentence for each sign.

Each piece of advice stands for one sign, and is given for it alone:

- The estimate does not explain what was seen, or the net has seen nothing like it: a mask or a plane may be wrong.
- The net knows no such cloth: its measures may be wrong.
- A part of the estimate is unsure. What lies beneath another layer is seen from nowhere above; where nothing was
  observed, another view helps; what is in view looks the same to the nets in the next picture.
- Few such plans came true, or they made things worse, or nothing is expected of the plan: a flat cloth and goals of
  fewer folds are easier, and a look after the first step finds what the nets predicted wrongly.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from clothkit.app.agreement import EstimateAgreement
from clothkit.app.plan_file import UNLIKELY, WORSE
from clothkit.app.plan_parts import UnsurePart
from clothkit.app.planner import State
from clothkit.app.unsure import PartName
from clothkit.cloth.silhouette import centred, silhouette
from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import RESOLUTION
from clothkit.dataset.store import STEPS
from clothkit.manipulation.named_folds import GOALS
from clothkit.observation.coverage import EXTENT
from clothkit.planning.trust import NEAR

LOW_TRUST = 0.5
"""Fewer than half of the plans came true."""

LEAST_UNSURE = 0.1
"""Share of the cloth from which advice is given about its unsure part."""

FLAT = 0.9
"""Share of its area that a cloth covers from which there is nothing to unfold."""

_WORDS: dict[PartName, str] = {
    "corner": "a corner",
    "edge": "an edge",
    "rim": "its rim",
    "quarter": "a quarter",
    "middle": "its middle",
    "half": "one half",
    "whole": "all of it",
}


class Signs(NamedTuple):
    """What tells how sure an estimate is and, if there is one, the plan that starts from it."""

    state: EstimateAgreement | None = None
    """Of the state's estimate with what was seen; None: not estimated. Likewise of the goal's."""
    goal: EstimateAgreement | None = None
    unsure: UnsurePart | None = None
    """Where the state's estimate is poor; None: not estimated."""
    trust: float | None = None
    """The share of such plans that came true; None: not known."""
    warning: str | None = None
    """What speaks against the plan: UNLIKELY, WORSE or nothing."""
    away: float | None = None
    """Distance of the state from the goal [cloth length]; None: not known."""
    steps: int = 0
    """The number of the plan's manipulations; 0: there is no plan yet."""
    flat: bool = False
    """Whether the cloth lies spread out."""
    named: str | None = None
    """The name of a named goal."""


def warning_of(improves: bool, outcome: float | None, no_action: float | None) -> str | None:
    """Return what speaks against a plan; None: nothing.

    `improves` says whether the nets expect its outcome to be nearer to the goal than the cloth lies now, `outcome` how
    far plans with such an expectation ended from their goals, and `no_action` how far the cloth lies now, in one unit;
    None: not known.
    """
    if not improves:
        return UNLIKELY
    return WORSE if outcome is not None and no_action is not None and outcome > no_action else None


def told_of(signs: Signs) -> list[str]:
    """Return where the estimate is poor, if it is, and the advice, a sentence each."""
    poor = [unsure_in_words(signs.unsure)] if signs.unsure is not None and signs.unsure.share else []
    return [*poor, *(f"advice: {sentence}" for sentence in advice(signs))]


def unsure_in_words(unsure: UnsurePart) -> str:
    """Return a sentence about the unsure part of an estimate, which has one."""
    assert unsure.part is not None
    assert unsure.centre_m is not None
    where = ", ".join(f"{value:.3f}" for value in unsure.centre_m)
    beneath = f"; {100 * unsure.hidden:.0f} % of this lies beneath another layer" if unsure.hidden else ""
    return (
        f"where {100 * unsure.share:.0f} % of the cloth lies is unsure (sigma above "
        f"{1000 * unsure.threshold_m:.0f} mm): {_WORDS[unsure.part]}, around ({where}) m{beneath}"
    )


def advice(signs: Signs) -> list[str]:
    """Return what to do, a sentence for each sign that asks for something."""
    found = [*_of_estimate("state", signs.state), *_of_estimate("goal", signs.goal)]
    if signs.unsure is not None and signs.unsure.share >= LEAST_UNSURE:
        found.append(_of_unsure(signs.unsure))
    if signs.warning == UNLIKELY:
        found.append(_of_useless(signs))
    elif signs.warning == WORSE:
        found.append(f"leave the cloth as it lies, or {_easier(signs)}")
    elif signs.trust is not None and signs.trust < LOW_TRUST:
        found.append(f"few such plans came true: {_step_by_step(signs)}{_easier(signs)}")
    return found


def _of_estimate(what: str, agreement: EstimateAgreement | None) -> list[str]:
    if agreement is None or agreement.reliable:
        return []
    found = []
    if not agreement.cloth_known:
        found.append("measure the cloth's sides and thickness anew; if they are right, take nets that know such cloths")
    # `known` is of the voxels and of the cloth.
    if not agreement.explains or (not agreement.known and agreement.cloth_known):
        otherwise = "spread the cloth out" if what == "state" else "fold the goal more neatly, or take a named one"
        found.append(
            f"look at the {what} again: nothing but the cloth may be in its mask or box, no hand in view, and the "
            f"table's plane has to be right; if all that is so, {otherwise}"
        )
    return found


def _of_unsure(unsure: UnsurePart) -> str:
    if unsure.hidden >= 0.5:
        return "no camera above sees beneath a layer: lift or unfold the unsure part, and look again"
    if unsure.unseen >= 0.5:
        return "nothing was observed at the unsure part: look again from another side, with nothing in front of it"
    return "the unsure part is in view, and another picture would show about the same: spread it out, and look again"


def _of_useless(signs: Signs) -> str:
    if signs.away is not None and signs.away <= NEAR:
        return f"the cloth is within {NEAR:g} cloth lengths of its goal: leave it as it lies"
    more = ", or more steps (--steps auto)" if signs.steps < STEPS else ""
    return f"try another seed (--seed){more}; if that does not help, {_easier(signs)}"


def _step_by_step(signs: Signs) -> str:
    return "execute the first step alone, look, and plan anew (--after); or " if signs.steps > 1 else ""


def _easier(signs: Signs) -> str:
    """What makes a task easier: a flat cloth, and a goal of fewer folds."""
    first = [] if signs.flat else ["unfold the cloth first"]
    if signs.named is None:
        return " or ".join([*first, "choose a goal with fewer folds"])
    simpler = simpler_goal(signs.named)
    if simpler is not None:
        return " or ".join([*first, f"fold {simpler} first, which {signs.named} begins with"])
    if GOALS[signs.named].manipulations > 1:
        return " or ".join([*first, "choose a goal with fewer folds"])
    return first[0] if first else "see what the simulator makes of the plan (clothkit simulate)"


def simpler_goal(name: str) -> str | None:
    """Return the named goal of the most folds that another one begins with; None: there is none."""
    folds = [(fold.point, fold.image) for fold in GOALS[name].folds(SQUARE)]
    begins = []
    for other, goal in GOALS.items():
        first = [(fold.point, fold.image) for fold in goal.folds(SQUARE)]
        if len(first) < len(folds) and first == folds[: len(first)]:
            begins.append((len(first), other))
    return max(begins)[1] if begins else None


def is_flat(state: State, cloth: Float[np.ndarray, "3"]) -> bool:
    """Return whether a state covers as much as a cloth with these sides [normalised] does that is spread out."""
    if state.shape == RESOLUTION:
        area = float((state > 0).any(-1).mean()) * 4
    else:
        area = float(silhouette(centred(state.astype(np.float32))[0], extent=EXTENT).mean()) * (2 * EXTENT) ** 2
    return area >= FLAT * float(cloth[0] * cloth[1])
