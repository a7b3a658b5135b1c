"""A search that reports its progress: it runs the strains in batches, and gives the best plan after each batch.

A search is one compiled program, which returns nothing until its end. Strains are independent of one another, so a
search with 64 strains can be replaced by four with 16, of which the best plan is kept. Between these, progress can be
shown and the search stopped. Its random numbers differ from those of `clothkit plan`, so its plan may differ, too.
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
"""Strains in a batch. A multiple of eight, as a search's number of strains must be."""


class Progress(NamedTuple):
    """The progress of a search."""

    done: int
    """Number of strains that are done."""
    strains: int
    """Number of strains in total."""
    best: Planned | None
    """The best plan so far; None before the first batch is done."""
    lowest: Float[np.ndarray, " evaluations"]
    """The lowest loss up to each iteration, over the batches one after the other."""
    tried: int
    """Number of plans that an iteration evaluates."""


Watch = Callable[[Progress], bool]
"""Called with the progress of a search; returns whether to continue."""


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
    """Run a search that calls `watch` before each batch and at the end; return its final progress.

    Stops early when `watch` returns False. Raises InputError when the nets have no reference values for plans of that
    length.
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
        # The carried plan is an initial value in the first batch only; in later ones it would give the same result.
        problem = problem._replace(later=np.array(False))
    watch(progress)
    return progress
