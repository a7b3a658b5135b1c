"""How many manipulations: the number from which one more is not expected to be worth it (section 8)."""

from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge
from jaxtyping import Float, Int

from clothkit.cloth.symmetry import equal_labellings
from clothkit.planning.representation import Representation
from clothkit.planning.types import UNKNOWN, Memory, States
from clothkit.runtime.config import config


@config
class LengthConfig:
    """How the number of a plan's manipulations is chosen."""

    margin: Annotated[float, Ge(0)] = 0.03
    """By how much nearer to the goal each manipulation beyond the first has to be expected to bring the cloth, in the
    representation's measure of the null check: cloth lengths for meshes. The default was chosen on validation tasks of
    scale laptop (`studies/plan_length.py --margins`)."""


def chosen_lengths(
    now: Float[np.ndarray, " task"], expected: Float[np.ndarray, "task length"], settings: LengthConfig
) -> Int[np.ndarray, " task"]:
    """The number of manipulations, 0 or more, for which expected distance + margin * (number - 1) is the lowest.

    Between nothing and one manipulation there is no margin, as in the null check: what nets expect has their own errors
    in it, which count against every plan, and not against the state as it is.
    `now` are the distances from the goal if nothing is done, `expected` those after the best plans of one, two, ..
    manipulations; infinite where there is no plan. Of equal ones, the fewest manipulations are chosen.
    """
    distance = np.concatenate([now[:, None], expected], axis=1)
    further = np.maximum(np.arange(distance.shape[1]) - 1, 0)
    return np.argmin(distance + settings.margin * further, axis=1)


class Nearest(NamedTuple):
    """The relabelling of each task's goal that its state is nearest to, and how near."""

    distance: Float[np.ndarray, " task"]
    relative: Int[np.ndarray, " task"]


def nearest_labelling(representation: Representation, state: States, memory: Memory) -> Nearest:
    """How far states are from their goals; where the goal's labelling is not fixed, in the nearest one.

    Labellings that exchange the sides of a cloth that is no square are left out.
    """
    same = np.asarray(equal_labellings(memory.cloth))
    distance = np.full((representation.labels, len(state)), np.inf)
    for k in range(representation.labels):
        goal = representation.relabel(memory.goal, np.full(len(state), k))
        distance[k] = np.where(same[:, k], representation.distance(state, goal), np.inf)
    relative = np.where(memory.relative == UNKNOWN, distance.argmin(0), memory.relative)
    return Nearest(np.take_along_axis(distance, relative[None], axis=0)[0], relative)
