"""Model predictive path integral control (MPPI): the mean of noisy plans, weighted by how low their losses are.

Williams et al., Information Theoretic MPC for Model-Based Reinforcement Learning (ICRA 2017), algorithm 2: noise is
added to a nominal plan, and the next nominal plan is the mean of the noisy ones with weights exp(-(loss - least loss) /
temperature). Its cost of control, which draws plans towards zero, is left out: this is the case alpha = 1 of Williams
et al., Information-Theoretic Model Predictive Control (T-RO 2018). UniClothDiff plans with MPPI through its model of
cloth (Tian et al., 2025).

Differences: A plan is improved by several iterations before it is executed, where Williams et al. improve it by one
between two of many short time steps. The nominal plan has categorical parts (distribution.py), whose probabilities are
the sums of the weights; as noise does for the continuous parts, a share of the plans explores random ones. There is no
nominal plan at first, but a population of random plans.
"""

from typing import Annotated

import jax
import jax.numpy as jnp
from annotated_types import Ge, Gt, Le
from jaxtyping import Array, Float, PRNGKeyArray

from clothkit.planning.optimisers.distribution import (
    Choices,
    PlanDistribution,
    choices_of,
    complete,
    draw_choices,
    fit,
    mode,
    random_draws,
)
from clothkit.planning.optimisers.population import (
    check_sizes,
    evaluate_in_chunks,
    first_population,
    keep_best,
    nothing_yet,
)
from clothkit.planning.optimisers.space import Best, Evaluate, Initial, Outcome, Plans, Space, select
from clothkit.runtime.config import config

Count = Annotated[int, Gt(0)]


@config
class MPPIConfig:
    """Sizes of MPPI. No numbers are published for manipulations of cloth; by default it evaluates as many as CEM."""

    plans: Count = 1000
    """Plans of each population."""
    iterations: Count = 20
    temperature: Annotated[float, Gt(0)] = 0.05
    """lambda: difference in loss at which a plan has e times less weight."""
    std: Annotated[float, Gt(0)] = 0.25
    """Standard deviation of the noise on later grasp points [geodesic] and on displacements [normalised]."""
    explore: Annotated[float, Ge(0), Le(1)] = 0.2
    """Share of the plans that have the discrete parts of random plans."""
    chunk: Count = 250
    """Plans that are evaluated at a time; `plans` is a multiple of it, or less."""
    finalists: Count = 64
    """Best plans that are evaluated exactly at the end."""

    def __post_init__(self) -> None:
        check_sizes(self.plans, self.chunk, self.finalists)

    def evaluations(self, length: int) -> int:
        """Number of plans that a search evaluates, whatever their length."""
        return self.plans * self.iterations

    def shape(self, length: int) -> tuple[int, int]:
        """Iterations and plans in each."""
        return self.iterations, self.plans


def path_integral(
    evaluate: Evaluate, space: Space, settings: MPPIConfig, *, initial: Initial | None = None, key: PRNGKeyArray
) -> Outcome:
    """Search by MPPI; initial plans are part of the first population. Plans that are not valid have no weight.

    The first plan of each later population is the nominal one: the most probable discrete parts, without noise.
    """
    key_first, key_rest = jax.random.split(key)
    population = first_population(space, initial, settings.plans, key=key_first)
    nominal = fit(space, population.plan, jnp.ones(settings.plans))

    def iterate(
        state: tuple[Plans, PlanDistribution, Best], key: PRNGKeyArray
    ) -> tuple[tuple[Plans, PlanDistribution, Best], Array]:
        population, nominal, best = state
        tried = evaluate_in_chunks(evaluate, space, population, settings.chunk)
        nominal = fit(space, population.plan, weights(tried.loss, settings.temperature), nominal)
        key_random, key_draws, key_explore = jax.random.split(key, 3)
        random = space.sample(settings.plans, key=key_random)
        draws = random_draws(settings.plans, space.length, key=key_draws)
        explores = jax.random.bernoulli(key_explore, settings.explore, (settings.plans,))
        choices: Choices = select(explores, choices_of(space, random.plan), draw_choices(nominal, draws))
        plan = complete(space, nominal, choices, draws.noise, jnp.full_like(nominal.mean, settings.std))
        plan = plan.at[0].set(mode(space, nominal))
        return (Plans(plan, random.labels), nominal, keep_best(best, tried)), tried.loss

    start = (population, nominal, nothing_yet(population, settings.finalists))
    (_, _, best), losses = jax.lax.scan(iterate, start, jax.random.split(key_rest, settings.iterations))
    return Outcome(best, losses)


def weights(loss: Float[Array, " plans"], temperature: float) -> Float[Array, " plans"]:
    """exp(-(loss - least loss) / temperature), not normalised; zero where a loss is infinite."""
    least = jnp.min(loss)
    excess = jnp.where(jnp.isfinite(loss), loss - jnp.where(jnp.isfinite(least), least, 0), jnp.inf)
    return jnp.exp(-excess / temperature)
