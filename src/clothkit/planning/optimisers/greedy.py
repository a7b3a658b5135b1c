"""Greedy search: the manipulation that brings the cloth nearest to the goal, then the next one that does, and so on.

Yan et al., Learning Predictive Representations for Deformable Objects Using Contrastive Estimation (CoRL 2020), draw
single manipulations at random and execute the one whose predicted outcome is nearest to the goal. Here the nets predict
the outcome from which the next manipulation is chosen, so that a whole plan results. A goal that can only be reached by
moving away from it first is not found (section 2.2).
"""

from typing import Annotated

import jax
import jax.numpy as jnp
from annotated_types import Gt
from jaxtyping import Array, Float, PRNGKeyArray

from clothkit.planning.optimisers.population import (
    check_sizes,
    evaluate_in_chunks,
    first_population,
    keep_best,
    nothing_yet,
)
from clothkit.planning.optimisers.space import Best, Evaluate, Initial, Outcome, Plans, Space
from clothkit.runtime.config import config

Count = Annotated[int, Gt(0)]


@config
class GreedyConfig:
    """Size of a greedy search."""

    plans: Count = 2000
    """Random manipulations that are tried for each step of the plan."""
    chunk: Count = 250
    """Plans that are evaluated at a time; `plans` is a multiple of it, or less."""
    finalists: Count = 64
    """Best plans that are evaluated exactly at the end; they differ in their last manipulations alone."""

    def __post_init__(self) -> None:
        check_sizes(self.plans, self.chunk, self.finalists)

    def evaluations(self, length: int) -> int:
        """Number of plans that a search evaluates; all but `plans` of them are evaluated up to an earlier step."""
        return self.plans * length

    def shape(self, length: int) -> tuple[int, int]:
        """Iterations and plans in each."""
        return length, self.plans


def greedy(
    evaluate: Evaluate, space: Space, settings: GreedyConfig, *, initial: Initial | None = None, key: PRNGKeyArray
) -> Outcome:
    """Choose one manipulation after the other; those of initial plans are tried beside random ones, each at its step.

    For each step, the objective is evaluated as if the plan ended there.
    """
    # Every step draws whole plans, of which it uses one manipulation each.
    steps = jnp.arange(space.length)
    keys = jax.random.split(key, space.length)
    nothing = nothing_yet(first_population(space, initial, settings.plans, key=keys[0]), settings.finalists)

    def choose_next(
        state: tuple[Float[Array, "n 6"], Best], each: tuple[Array, PRNGKeyArray]
    ) -> tuple[tuple[Float[Array, "n 6"], Best], Array]:
        chosen, _ = state
        step, key = each
        drawn = first_population(space, initial, settings.plans, key=key)
        plan = jnp.where((steps < step)[:, None], chosen, drawn.plan)
        tried = evaluate_in_chunks(evaluate, space, Plans(plan, drawn.labels), settings.chunk, step + 1)
        best = keep_best(nothing, tried)
        return (best.plans.plan[0], best), tried.loss

    (_, best), losses = jax.lax.scan(choose_next, (jnp.zeros((space.length, 6)), nothing), (steps, keys))
    return Outcome(best, losses)
