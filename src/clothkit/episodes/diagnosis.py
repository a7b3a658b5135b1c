"""Diagnosis of failures: compares a search's plan with the recorded manipulations (section 6.4)."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from clothkit.cloth.equivalents import equivalents_of_manipulation, relabel_manipulation_batch
from clothkit.cloth.grid import CLOTH_SIDE
from clothkit.episodes.record import Sessions, Stretch
from clothkit.planning.batches import in_batches
from clothkit.planning.draw import Candidates
from clothkit.planning.forward import Forward
from clothkit.planning.loss import Weights
from clothkit.planning.planner import Planner
from clothkit.planning.search import UNKNOWN, Problem, Reference, fix, planning_loss
from clothkit.planning.sight import Sight

_relabelled = jax.jit(relabel_manipulation_batch)

NEAR = 0.05 * CLOTH_SIDE
"""Largest distance from a recorded grasp point to the nearest candidate at which it counts as offered [normalised]."""


def note_recorded(sessions: Sessions, goals: np.ndarray, recorded: list[Stretch], planner: Planner) -> None:
    """Fill the fields `loss_recorded` and `offered` of `sessions`, in place.

    `loss_recorded` is the planning loss of the recorded manipulations from the first estimate, and `offered` tells
    whether the candidates of the first step include their grasp points. The recorded manipulations are relabelled to
    match the first estimates. This uses the true states, which no planner has.
    """
    sight = planner.sight
    labels = sight.labels(sessions.estimate[:, 0], sessions.state[:, 0])
    for length in np.unique(sessions.length).tolist():
        chosen = np.flatnonzero(sessions.length == length)
        states, manipulations = (np.stack(parts) for parts in zip(*(recorded[task] for task in chosen), strict=True))
        plan = sight.recorded(states, manipulations).plan
        plan = np.asarray(_relabelled(plan, labels[chosen]))
        sessions.loss_recorded[chosen] = in_batches(
            partial(
                losses,
                sight.forward,
                planner.nets,
                planner.normalisation.reference(length),
                planner.weights,
                float(planner.weights.alpha) > 0,
                0 if sight.labelled else UNKNOWN,
            ),
            planner.settings.batch,
            sessions.estimate[chosen, 0],
            goals[chosen],
            plan,
        )
        seen = sessions.estimate[chosen, 0]
        wanted = sight.places(seen, plan[:, 0, :4].reshape(-1, 2, 2))
        sessions.offered[chosen] = [
            offered(wanted[i], _places(sight, seen[i], sessions.candidates[task, 0])) for i, task in enumerate(chosen)
        ]


def _places(sight: Sight, seen: np.ndarray, candidates: Float[np.ndarray, "c 2"]) -> Float[np.ndarray, "present 2"]:
    present = np.isfinite(candidates[:, 0])
    # Padding is converted too, so that shapes are the same for all states and the function is compiled only once.
    pairs = np.repeat(np.nan_to_num(candidates)[:, None], 2, axis=1)
    return sight.places(np.repeat(seen[None], len(candidates), axis=0), pairs)[present, 0]


def offered(wanted: Float[np.ndarray, "2 2"], offers: Float[np.ndarray, "c 2"]) -> Bool[np.ndarray, ""]:
    """Whether every wanted grasp point has a candidate within NEAR; both arguments are xy [normalised]."""
    distance = np.linalg.norm(wanted[:, None] - offers, axis=-1)
    return np.asarray((distance.min(axis=1) <= NEAR).all())


@partial(jax.jit, static_argnums=(0, 4, 5))
def losses(
    forward: Forward,
    nets: tuple[Any, ...],
    reference: Reference,
    weights: Weights,
    explicit: bool,
    relative: int,
    states: Shaped[Array, "task *state"],
    goals: Shaped[Array, "task *state"],
    plans: Float[Array, "task n 6"],
) -> Float[Array, " task"]:
    """The planning loss of one given plan per task, `[task]`.

    It is the minimum over the common equivalents and, where `relative` is UNKNOWN, over the goal's relabellings.
    """
    count = forward.labels

    def one(state: Array, goal: Array, plan: Array) -> Array:
        blank = [jax.eval_shape(forward.encode, net, state) for net in nets]
        traces = tuple(jnp.zeros((count, *latent.shape)) for latent in blank)
        none = Candidates(jnp.zeros((1, 2)), jnp.int32(0))
        problem = Problem(state, goal, none, traces, jnp.int32(relative), jnp.asarray(False), plan)
        relabelled = jax.vmap(equivalents_of_manipulation, out_axes=1)(plan)[:count]
        loss, _, _ = planning_loss(
            forward,
            nets,
            fix(forward, nets, problem),
            reference,
            weights,
            relabelled,
            jnp.arange(count),
            jnp.full(count, relative),
            explicit=explicit,
        )
        return jnp.min(loss)

    return jax.vmap(one)(states, goals, plans)
