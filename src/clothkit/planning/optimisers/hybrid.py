"""Several optimisers in turn: each begins with the best plans of the one before.

By default the cross-entropy method looks for promising plans, and gradient descent improves on them, with ever fewer
strains.
"""

from typing import Annotated

import jax
import jax.numpy as jnp
from annotated_types import MinLen
from jaxtyping import PRNGKeyArray

from clothkit.planning.optimisers.cem import CEMConfig
from clothkit.planning.optimisers.gradient import GradientConfig
from clothkit.planning.optimisers.registry import AnySettings, optimiser_of
from clothkit.planning.optimisers.space import Evaluate, Initial, Outcome, Space
from clothkit.runtime.config import config


@config
class HybridConfig:
    """The phases of a search."""

    phases: Annotated[tuple[AnySettings, ...], MinLen(1)] = (
        CEMConfig(plans=1000, iterations=5, elites=200, finalists=128),
        GradientConfig(strains=128, base_iterations=20, iterations_per_step=20, near=0.5, halvings=2),
    )
    """Settings of the optimisers, in order. A phase begins with the finalists of the phase before, as far as its own
    population goes, and with random plans if there are fewer."""

    @property
    def finalists(self) -> int:
        """Those of the last phase."""
        return self.phases[-1].finalists

    def evaluations(self, length: int) -> int:
        """Number of plans of this length that all phases evaluate."""
        return sum(phase.evaluations(length) for phase in self.phases)

    def shape(self, length: int) -> tuple[int, int]:
        """The iterations of all phases, and the plans of the largest population."""
        shapes = [phase.shape(length) for phase in self.phases]
        return sum(iterations for iterations, _ in shapes), max(plans for _, plans in shapes)


def in_turn(
    evaluate: Evaluate, space: Space, settings: HybridConfig, *, initial: Initial | None = None, key: PRNGKeyArray
) -> Outcome:
    """Search by one optimiser after the other; the first begins with the initial plans.

    Losses are padded to the largest population of all phases.
    """
    outcomes = []
    for phase, key_phase in zip(settings.phases, jax.random.split(key, len(settings.phases)), strict=True):
        found = optimiser_of(phase).search(evaluate, space, phase, initial=initial, key=key_phase)
        # In order, because a phase with a smaller population takes the first of them.
        order = jnp.argsort(found.best.loss)
        plans, loss = jax.tree.map(lambda leaf, order=order: leaf[order], (found.best.plans, found.best.loss))
        initial = Initial(plans, jnp.isfinite(loss))
        outcomes.append(found)
    most = max(found.losses.shape[1] for found in outcomes)
    losses = [
        jnp.pad(found.losses, ((0, 0), (0, most - found.losses.shape[1])), constant_values=jnp.inf)
        for found in outcomes
    ]
    return Outcome(found.best, jnp.concatenate(losses))
