"""Random shooting: the best of many random plans.

VCD smooths cloth by the best of 500 random pick-and-place actions (Lin et al., Learning Visible Connectivity Dynamics
for Cloth Smoothing, CoRL 2021); as a planner for learned models of any kind see Nagabandi et al. (ICRA 2018).
"""

from typing import Annotated

import jax
from annotated_types import Gt
from jaxtyping import Array, PRNGKeyArray

from clothkit.planning.optimisers.population import (
    check_sizes,
    evaluate_in_chunks,
    first_population,
    keep_best,
    nothing_yet,
)
from clothkit.planning.optimisers.space import Best, Evaluate, Initial, Outcome, Space
from clothkit.runtime.config import config

Count = Annotated[int, Gt(0)]


@config
class RandomShootingConfig:
    """Size of a random search; 500 plans are what VCD draws."""

    plans: Count = 500
    chunk: Count = 250
    """Plans that are drawn and evaluated at a time; `plans` is a multiple of it, or less."""
    finalists: Count = 64
    """Best plans that are evaluated exactly at the end; at most as many as are drawn at a time."""

    def __post_init__(self) -> None:
        check_sizes(self.plans, self.chunk, min(self.plans, self.finalists))
        if self.finalists > min(self.plans, self.chunk):
            raise ValueError(f"finalists must be at most plans and chunk ({min(self.plans, self.chunk)})")

    def evaluations(self, length: int) -> int:
        """Number of plans that a search evaluates, whatever their length."""
        return self.plans

    def shape(self, length: int) -> tuple[int, int]:
        """Iterations and plans in each."""
        return self.plans // min(self.chunk, self.plans), min(self.chunk, self.plans)


def shoot(
    evaluate: Evaluate,
    space: Space,
    settings: RandomShootingConfig,
    *,
    initial: Initial | None = None,
    key: PRNGKeyArray,
) -> Outcome:
    """Evaluate random plans and the initial ones, which take the places of the first random ones."""
    count = min(settings.chunk, settings.plans)
    key_first, key_rest = jax.random.split(key)
    population = first_population(space, initial, count, key=key_first)

    def iterate(state: tuple, key: PRNGKeyArray) -> tuple[tuple, Array]:
        population, best = state
        tried = evaluate_in_chunks(evaluate, space, population, count)
        return (space.sample(count, key=key), keep_best(best, tried)), tried.loss

    start: tuple[object, Best] = (population, nothing_yet(population, settings.finalists))
    keys = jax.random.split(key_rest, settings.plans // count)
    (_, best), losses = jax.lax.scan(iterate, start, keys)
    return Outcome(best, losses)
