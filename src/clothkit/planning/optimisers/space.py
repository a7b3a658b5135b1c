"""What an optimiser is told of a search, and what it returns: the space of plans, the objective, and the best plans.

An optimiser is a pure function `(evaluate, space, settings, *, initial, key) -> Outcome` of fixed shapes, for one
search; `jax.vmap` makes it one for a batch of searches. Plans are in the labels of the initial state throughout. What
else the objective needs to know of a plan (the common equivalent in which it is evaluated, the relative labelling of
the goal) goes with it as its `labels`, which optimisers pass on without reading them.

The first grasp points of a plan are a pair of candidates (twice the same one for one hand), so optimisers exchange them
and never move them. All else is continuous: later grasp points within -1..1, and displacements.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from clothkit.planning.batches import take


class Plans(NamedTuple):
    """Plans, one per row."""

    plan: Float[Array, "plans n 6"]
    labels: Any
    """A pytree of arrays with a row per plan, of which only the objective and the space know the meaning."""


class Initial(NamedTuple):
    """Plans to begin with, such as the rest of a plan whose first manipulation was executed."""

    plans: Plans
    given: Bool[Array | np.ndarray, " plans"]
    """Whether a row holds a plan; the other rows have no influence."""


class Space(NamedTuple):
    """The plans among which to search for one task."""

    length: int
    """Number of manipulations of a plan, n."""
    candidates: Float[Array | np.ndarray, "candidates 2"]
    """Grasp points for the first manipulation; the rows from `present` on are padding."""
    present: Int[Array | np.ndarray, ""] | int
    sample: Callable[..., Plans]
    """count, *, draws, key -> count * draws random plans

    Where labels are assigned in turn, each `draws` (default 1) consecutive plans have the same."""
    valid: Callable[[Plans], Bool[Array, " plans"]]
    """Whether the plans meet all restrictions; one that doesn't is never chosen."""
    variants: Callable[[Plans], Plans] = lambda plans: plans
    """count plans -> count * k plans: each k consecutive ones are one plan with all labels that it can have."""


class Evaluation(NamedTuple):
    """What the objective says of plans."""

    loss: Float[Array, " plans"]
    """Lower is better."""
    labels: Any
    """The plans' labels, with those settled that had been left open."""
    terms: Any = ()
    """The terms of the loss, a pytree of arrays with a row per plan; reported for the plan that is chosen."""


@runtime_checkable
class Evaluate(Protocol):
    """The objective: a pure, differentiable function of plans."""

    def __call__(self, plans: Plans, *, steps: Int[Array, ""] | None = None, exact: bool = False) -> Evaluation:
        """Evaluate plans, or only their first `steps` manipulations.

        With `exact`, no approximation is used that makes evaluations cheaper. An optimiser's own evaluations are not
        exact; those by which the plan is chosen in the end are.
        """
        ...


@runtime_checkable
class Settings(Protocol):
    """What the settings of every optimiser can tell of a search."""

    @property
    def finalists(self) -> int:
        """Number of best plans in the outcome."""
        ...

    def evaluations(self, length: int) -> int:
        """Number of plans of this length that a search evaluates, without the exact evaluations of the finalists."""
        ...

    def shape(self, length: int) -> tuple[int, int]:
        """The shape of `Outcome.losses` of a search for plans of this length: iterations and plans."""
        ...


class Best(NamedTuple):
    """The best plans found so far, one per row."""

    plans: Plans
    labels: Any
    """Labels of the plans as the objective settled them; those in `plans` are as they were before."""
    loss: Float[Array, " plans"]
    """Infinite where a row holds no valid plan."""


class Outcome(NamedTuple):
    """What an optimiser returns."""

    best: Best
    losses: Float[Array, "iterations plans"]
    """Losses of the plans of each iteration, not exact; infinite if invalid, or where nothing was evaluated.

    Evaluations before, between and after iterations are not among them: of screened plans, other labels, exact ones."""


class Result(NamedTuple):
    """The plan that a search has chosen, with a record of the search.

    If no valid plan was found, all of `losses` are infinite, and the plan is any.
    """

    plan: Float[Array, "n 6"]
    labels: Any
    loss: Float[Array, ""]
    """The exact loss of the plan."""
    terms: Any
    losses: Float[Array, "iterations plans"]


def choose(evaluate: Evaluate, outcome: Outcome) -> Result:
    """Choose the finalist of the lowest exact loss."""
    best = outcome.best
    exact = evaluate(Plans(best.plans.plan, best.labels), exact=True)
    winner = jnp.argmin(jnp.where(jnp.isinf(best.loss) | jnp.isnan(exact.loss), jnp.inf, exact.loss))
    plan, labels, terms = jax.tree.map(lambda leaf: leaf[winner], (best.plans.plan, exact.labels, exact.terms))
    return Result(plan, labels, exact.loss[winner], terms, outcome.losses)


def masked(loss: Float[Array, " plans"], valid: Bool[Array, " plans"]) -> Float[Array, " plans"]:
    """The losses of valid plans, infinite for all others and where a loss is not finite."""
    return jnp.where(valid & jnp.isfinite(loss), loss, jnp.inf)


def select(condition: Bool[Array, " rows"], yes: Any, no: Any) -> Any:
    """For each row of two pytrees, that of `yes` where the condition holds, otherwise that of `no`."""
    return jax.tree.map(lambda a, b: jnp.where(condition.reshape(-1, *(1,) * (a.ndim - 1)), a, b), yes, no)


def clip_grasps(plan: Float[Array, "*plans 6"]) -> Float[Array, "*plans 6"]:
    """The plans with all grasp points clipped to -1..1."""
    return jnp.concatenate([jnp.clip(plan[..., :4], -1, 1), plan[..., 4:]], axis=-1)


def begin_with(initial: Initial | None, count: int, drawn: Plans) -> tuple[Plans, Bool[Array, " plans"]]:
    """The plans `drawn`, of which the first are replaced by those of `initial`; and which were replaced.

    Initial plans beyond the number of drawn ones are dropped.
    """
    if initial is None:
        return drawn, jnp.zeros(count, bool)
    # Rows beyond the initial ones repeat them, and are marked as not given.
    rows = jnp.arange(count) % len(initial.given)
    given = jnp.asarray(initial.given)[rows] & (jnp.arange(count) < len(initial.given))
    return select(given, take(initial.plans, rows), drawn), given
