"""The cross-entropy method (CEM): plans are drawn from a distribution, which is fitted to the best of them, and so on.

De Boer et al., A Tutorial on the Cross-Entropy Method (Annals of Operations Research, 2005), with smoothed updating,
for frequencies and for normal distributions. Its sizes are those with which VisuoSpatial Foresight folds cloth (Hoque
et al., RSS 2020, and its code): 2,000 plans, 10 iterations, 400 elites, a share of 0.1 of the old parameters (of
variances, not of standard deviations), and normal distributions that are truncated at two standard deviations.

Differences: The first grasp points and the numbers of hands are categorical variables (distribution.py); VSF has one
hand, which it lets grasp anywhere. The first distribution is that of random plans, with the moments of the first
population. The first plan of each later population is the most probable one, and the result is the best plan that was
evaluated; VSF executes the last mean, which is never evaluated. Each new plan draws its common equivalent afresh, so
that the distribution does not depend on it.
"""

from typing import Annotated

import jax
import jax.numpy as jnp
from annotated_types import Ge, Gt, Lt
from jaxtyping import Array, PRNGKeyArray

from clothkit.planning.optimisers.distribution import (
    PlanDistribution,
    complete,
    draw_choices,
    fit,
    mixed,
    mode,
    random_draws,
)
from clothkit.planning.optimisers.population import (
    check_sizes,
    evaluate_in_chunks,
    first_population,
    keep_best,
    lowest,
    nothing_yet,
)
from clothkit.planning.optimisers.space import Best, Evaluate, Initial, Outcome, Plans, Space
from clothkit.runtime.config import config

Count = Annotated[int, Gt(0)]


@config
class CEMConfig:
    """Sizes of the cross-entropy method; the defaults are those of VisuoSpatial Foresight."""

    plans: Count = 2000
    """Plans of each population."""
    iterations: Count = 10
    elites: Count = 400
    """Best plans of a population, to which the next distribution is fitted."""
    smoothing: Annotated[float, Ge(0), Lt(1)] = 0.1
    """Share of the old distribution's parameters in those of the new one."""
    chunk: Count = 250
    """Plans that are evaluated at a time; `plans` is a multiple of it, or less."""
    finalists: Count = 64
    """Best plans that are evaluated exactly at the end."""

    def __post_init__(self) -> None:
        check_sizes(self.plans, self.chunk, self.finalists)
        if self.elites > self.plans:
            raise ValueError(f"elites must be at most plans ({self.plans})")

    def evaluations(self, length: int) -> int:
        """Number of plans that a search evaluates, whatever their length."""
        return self.plans * self.iterations

    def shape(self, length: int) -> tuple[int, int]:
        """Iterations and plans in each."""
        return self.iterations, self.plans


def cross_entropy(
    evaluate: Evaluate, space: Space, settings: CEMConfig, *, initial: Initial | None = None, key: PRNGKeyArray
) -> Outcome:
    """Search by the cross-entropy method; initial plans are part of the first population.

    Plans that are not valid are never elites; if there are fewer valid plans than elites, these are all.
    """
    key_first, key_rest = jax.random.split(key)
    population = first_population(space, initial, settings.plans, key=key_first)
    distribution = fit(space, population.plan, jnp.ones(settings.plans))

    def iterate(
        state: tuple[Plans, PlanDistribution, Best], key: PRNGKeyArray
    ) -> tuple[tuple[Plans, PlanDistribution, Best], Array]:
        population, distribution, best = state
        tried = evaluate_in_chunks(evaluate, space, population, settings.chunk)
        elites = lowest(tried.loss, settings.elites)
        weight = jnp.isfinite(tried.loss[elites]).astype(float)
        fitted = fit(space, population.plan[elites], weight, distribution)
        distribution = mixed(distribution, fitted, settings.smoothing)
        key_labels, key_draws = jax.random.split(key)
        draws = random_draws(settings.plans, space.length, key=key_draws)
        std = jnp.sqrt(distribution.variance)
        plan = complete(space, distribution, draw_choices(distribution, draws), draws.noise, std)
        plan = plan.at[0].set(mode(space, distribution))
        labels = space.sample(settings.plans, key=key_labels).labels
        return (Plans(plan, labels), distribution, keep_best(best, tried)), tried.loss

    start = (population, distribution, nothing_yet(population, settings.finalists))
    (_, _, best), losses = jax.lax.scan(iterate, start, jax.random.split(key_rest, settings.iterations))
    return Outcome(best, losses)
