"""A search that can be watched: some of its strains after the others, and what is best after each lot.

A search is one compiled program, which says nothing until it is done. Strains know nothing of one another, so one of 64
strains is four of 16, of which the best plan is taken; between these there is something to see, and it can be stopped.
Its random numbers are others than those of `clothkit plan`, so the plan that it finds may differ, too.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from clothkit.app.planner import Past, Planned, find, planned_of, problem_of
from clothkit.app.viewer.session import Believed
from clothkit.planning.planner import Planner

AT_ONCE = 16
"""Strains of a lot. A multiple of eight, as searches are."""


class Progress(NamedTuple):
    """How far a search is."""

    done: int
    """Strains."""
    strains: int
    """In all."""
    best: Planned | None
    """The best plan so far; none before the first lot is through."""
    lowest: Float[np.ndarray, " evaluations"]
    """The lowest loss so far, for each iteration of each lot."""
    tried: int
    """Plans that an iteration tries."""


Watch = Callable[[Progress], bool]
"""Is told of progress, and says whether to go on."""


def find_watched(
    planner: Planner,
    state: Believed,
    goal: Believed,
    length: int,
    *,
    seed: int,
    watch: Watch,
    past: Past | None = None,
) -> Progress:
    """A search that tells of its progress; what it came to when it was through, or stopped.

    Raises InputError when the nets have no reference values for plans of that length.
    """
    strains = planner.settings.search.strains
    lot = min(AT_ONCE, strains)
    settings = dataclasses.replace(planner.settings.search, strains=lot)
    finder = dataclasses.replace(planner, settings=dataclasses.replace(planner.settings, search=settings)).finder(
        length
    )
    problem = problem_of(planner, state, goal, length, past=past)
    progress = Progress(0, strains, None, np.zeros(0, np.float32), lot)
    keys = jax.random.split(jax.random.key(seed), -(-strains // lot))
    for key in keys:
        if not watch(progress):
            break
        found = find(finder, problem, key)
        lowest = np.minimum.accumulate(np.append(progress.lowest, found.losses.min(-1)))
        best = progress.best
        if best is None or float(found.loss) < best.loss:
            best = planned_of(planner, problem, found)
        progress = Progress(min(progress.done + lot, strains), strains, best, lowest, lot)
        # The last plan's rest is a start of the first lot: the same start again would find the same again.
        problem = problem._replace(later=np.array(False))
    watch(progress)
    return progress
