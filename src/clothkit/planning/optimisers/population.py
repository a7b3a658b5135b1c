"""What optimisers have in common that evaluate one population of plans after the other."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from clothkit.planning.batches import take
from clothkit.planning.optimisers.space import Best, Evaluate, Initial, Plans, Space, begin_with, masked


def check_sizes(plans: int, chunk: int, finalists: int) -> None:
    """Raise ValueError unless a population divides into equal chunks, and has as many plans as are to be returned."""
    if plans > chunk and plans % chunk:
        raise ValueError(f"plans must be a multiple of chunk ({chunk}), or less")
    if finalists > plans:
        raise ValueError(f"finalists must be at most plans ({plans})")


def first_population(space: Space, initial: Initial | None, count: int, *, key: PRNGKeyArray) -> Plans:
    """Random plans, the first of which are replaced by the initial ones."""
    return begin_with(initial, count, space.sample(count, key=key))[0]


def evaluate_in_chunks(
    evaluate: Evaluate, space: Space, plans: Plans, chunk: int, steps: Int[Array, ""] | None = None
) -> Best:
    """Evaluate plans, or their first `steps` manipulations, at most `chunk` at a time; all rows are returned.

    This bounds the memory that an evaluation takes. Losses of plans that are not valid are infinite.
    """

    def score(part: Plans) -> Best:
        evaluation = evaluate(part, steps=steps)
        return Best(part, evaluation.labels, masked(evaluation.loss, space.valid(part)))

    count = len(plans.plan)
    if count <= chunk:
        return score(plans)
    parts = jax.tree.map(lambda leaf: leaf.reshape(count // chunk, chunk, *leaf.shape[1:]), plans)
    scored = jax.lax.map(score, parts)
    return jax.tree.map(lambda leaf: leaf.reshape(count, *leaf.shape[2:]), scored)


def nothing_yet(population: Plans, finalists: int) -> Best:
    """As many rows without a valid plan as there are to be finalists."""
    plans = take(population, jnp.arange(finalists))
    return Best(plans, plans.labels, jnp.full(finalists, jnp.inf))


def keep_best(best: Best, tried: Best) -> Best:
    """The best of both, as many as there are rows in `best`, in order of their losses; of equal ones, the earlier."""
    both = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), best, tried)
    return take(both, lowest(both.loss, len(best.loss)))


def lowest(loss: Float[Array, " plans"], count: int) -> Int[Array, " lowest"]:
    """The rows of the lowest losses in ascending order."""
    return jax.lax.top_k(-loss, count)[1]
