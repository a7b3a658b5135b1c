"""Plans whose loss is their distance from one that is known, so that every optimiser's answer is known too.

Every manipulation is compared with the target's: the grasp points in the better order of the hands, then the
displacement. A common equivalent goes with each plan as its label; the objective settles labels by adding 100, and its
terms tell both parts of the loss.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from clothkit.manipulation.vector import swap_grasps
from clothkit.planning.optimisers.space import Evaluate, Evaluation, Plans, Space

CANDIDATES = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1], [0.2, 0.1], [0, 0], [0, 0]], np.float32)
PRESENT = 5
REACH = 1.4
TARGET = np.array(
    [[1, -1, -1, 1, 0.6, -0.4], [-0.5, 0.3, -0.5, 0.3, -0.7, 0.2], [0.8, -0.6, -0.4, 0.5, 0.1, 0.9]], np.float32
)
"""Both hands on candidates, then one hand, then both hands again."""


def distance(plan: Array, target: Array | np.ndarray, steps: Array | None = None) -> tuple[Array, Array]:
    """The squared distances of grasp points and of displacements, summed over the first `steps` manipulations."""
    counted = 1 if steps is None else (jnp.arange(plan.shape[-2]) < steps).astype(float)
    either = [jnp.sum((each - target)[..., :4] ** 2, axis=-1) for each in (plan, swap_grasps(plan))]
    grasps = jnp.sum(counted * jnp.minimum(*either), axis=-1)
    return grasps, jnp.sum(counted * jnp.sum((plan - target)[..., 4:] ** 2, axis=-1), axis=-1)


def ripples(plan: Array) -> Array:
    """Many local minima along the first displacement, the lowest of which is the target's."""
    return 0.3 * jnp.sum(1 - jnp.cos(8 * jnp.pi * (plan - TARGET[: plan.shape[-2]])[:, 0, 4:]), axis=-1)


def objective(
    length: int,
    *,
    extra: Callable[[Array], Array] | None = None,
    count: Callable[[int], None] | None = None,
    offset: float = 0.0,
) -> Evaluate:
    """The objective, plus `extra`. Each evaluation calls `count` with the number of plans; exact ones add `offset`."""

    def evaluate(plans: Plans, *, steps: Array | None = None, exact: bool = False) -> Evaluation:
        if count:
            jax.debug.callback(partial(count, len(plans.plan)))
        grasps, displacements = distance(plans.plan, TARGET[:length], steps)
        loss = grasps + displacements + (extra(plans.plan) if extra else 0) + (offset if exact else 0)
        labels = {"common": plans.labels["common"] + 100}
        return Evaluation(loss, labels, {"grasps": grasps, "displacements": displacements})

    return evaluate


def space(length: int, *, valid: Callable[[Plans], Array] | None = None) -> Space:
    """Plans of such a length; all are valid by default."""

    def sample(count: int, *, draws: int = 1, key: Array) -> Plans:
        keys = jax.random.split(key, 5)
        rows = count * draws
        pair = jax.random.randint(keys[0], (rows, 2), 0, PRESENT)
        single = jax.random.bernoulli(keys[1], 1 / 3, (rows, length))
        pair = jnp.where(single[:, :1], pair[:, :1], pair)
        grasps = jax.random.uniform(keys[2], (rows, length, 4), minval=-1, maxval=1)
        second = jnp.where(single[..., None], grasps[..., :2], grasps[..., 2:])
        grasps = jnp.concatenate([grasps[..., :2], second], axis=-1)
        grasps = grasps.at[:, 0].set(jnp.asarray(CANDIDATES)[pair].reshape(-1, 4))
        displacement = jax.random.uniform(keys[3], (rows, length, 2), minval=-REACH, maxval=REACH)
        common = jax.random.randint(keys[4], (rows,), 0, 8)
        return Plans(jnp.concatenate([grasps, displacement], axis=-1), {"common": common})

    def all_valid(plans: Plans) -> Array:
        return jnp.ones(len(plans.plan), bool)

    def variants(plans: Plans) -> Plans:
        return Plans(jnp.repeat(plans.plan, 8, axis=0), {"common": jnp.tile(jnp.arange(8), len(plans.plan))})

    return Space(length, CANDIDATES, PRESENT, sample, valid or all_valid, variants)


def index_of(grasp: np.ndarray) -> int:
    """The candidate at a grasp point."""
    return int(np.abs(CANDIDATES[:PRESENT] - grasp).sum(-1).argmin())


def is_plan(plan: np.ndarray) -> bool:
    """Whether the first grasp points are candidates and the later ones lie within the cloth."""
    candidates = all(np.abs(CANDIDATES[:PRESENT] - grasp).sum(-1).min() == 0 for grasp in plan[0, :4].reshape(2, 2))
    return candidates and bool(np.abs(plan[:, :4]).max() <= 1)


def as_arrays(tree: Any) -> Any:
    """The pytree with NumPy arrays."""
    return jax.tree.map(np.asarray, tree)
