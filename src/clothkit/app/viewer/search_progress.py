"""A search that reports its progress: it runs the strains in batches, and gives the best plan after each batch.

A search is one compiled program, which returns nothing until its end. The strains of a gradient search hardly depend on
one another, so a search with 64 strains can be replaced by four with 16, of which the best plan is kept. Between these,
progress can be shown and the search stopped. Its random numbers differ from those of `clothkit plan`, and strains
restart near the best plan of their own batch alone, so its plan may differ, too. Other optimisers run in one piece, and
so does a gradient search with halvings, for which strains are compared with one another.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Shaped

from clothkit.planning.optimisers.gradient import GradientConfig
from clothkit.planning.planner import Planner
from clothkit.planning.plans import conclude, pose
from clothkit.planning.types import Memory, Plan

STRAINS_PER_BATCH = 16
"""Strains in a batch."""


class Progress(NamedTuple):
    """The progress of a search."""

    done: int
    """Number of strains that are done."""
    strains: int
    """Number of strains in total."""
    best: Plan | None
    """The best plan so far, as a batch of one; None before the first batch is done."""
    lowest: Float[np.ndarray, " evaluations"]
    """The lowest loss up to each iteration, over the batches one after the other."""
    tried: int
    """Number of plans that an iteration evaluates."""


OnProgress = Callable[[Progress], bool]
"""Called with the progress of a search; returns whether to continue."""


def search_in_batches(
    planner: Planner,
    state: Shaped[np.ndarray, "*state"],
    candidates: Float[np.ndarray, "candidate 2"],
    memory: Memory,
    *,
    seed: int,
    on_progress: OnProgress,
) -> Progress:
    """Run the search of a decision for one cloth, with `on_progress` called before each batch and at the end.

    `state` and `candidates` are what the agent perceives. Stops early when `on_progress` returns False. Returns
    the final progress. Raises InputError when the nets have no reference values for plans of that length.
    """
    length = int(memory.left[0])
    strains = planner.settings.search.optimiser.shape(length)[1]
    batched = _in_batches(planner)
    count = batched.settings.search.optimiser.shape(length)[1]
    problems = pose(planner, state[None].astype(np.float32), candidates[None], memory, length)
    progress = Progress(0, strains, None, np.zeros(0, np.float32), count)
    for key in jax.random.split(jax.random.key(seed), -(-strains // count)):
        if not on_progress(progress):
            break
        found = jax.tree.map(np.asarray, batched.search(problems, key.reshape(1), length=length))
        lowest = np.minimum.accumulate(np.append(progress.lowest, found.losses[0].min(-1)))
        best = progress.best
        if best is None or found.loss[0] < best.loss[0]:
            best = conclude(batched, problems, found, candidates[None])
        progress = Progress(min(progress.done + count, strains), strains, best, lowest, count)
        # The carried plan is an initial value in the first batch only; in later ones it would give the same result.
        problems = problems._replace(later=np.zeros(1, bool))
    on_progress(progress)
    return progress


def _in_batches(planner: Planner) -> Planner:
    """The planner for one batch of strains; the same planner if its search can't be divided."""
    search = planner.settings.search
    optimiser = search.optimiser
    if not isinstance(optimiser, GradientConfig) or optimiser.halvings:
        return planner
    fewer = dataclasses.replace(optimiser, strains=min(STRAINS_PER_BATCH, optimiser.strains))
    settings = dataclasses.replace(planner.settings, search=dataclasses.replace(search, optimiser=fewer))
    return dataclasses.replace(planner, settings=settings)
