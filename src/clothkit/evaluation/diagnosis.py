"""Diagnosis of failures: compares a search's plan with the recorded manipulations (section 6.4).

This uses true states and recorded manipulations, which no planner has.
"""

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, Shaped

from clothkit.cloth.mesh import best_label
from clothkit.cloth.symmetry import equivalents_of_manipulation, relabel_manipulation_batch
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.episodes.record import Sessions, Stretch, Tasks
from clothkit.episodes.sessions import search_keys
from clothkit.models.forward import ForwardModel
from clothkit.planning.batches import in_batches
from clothkit.planning.objective import Objective, evaluate, fix
from clothkit.planning.planner import Planner
from clothkit.planning.plans import Keys
from clothkit.planning.predict import padded
from clothkit.planning.representation import Representation
from clothkit.planning.search import posed_objective
from clothkit.planning.types import UNKNOWN, Candidates, Meshes, Problem, States

NEAR = 0.05 * CLOTH_LENGTH
"""Largest distance from a recorded grasp point to the nearest candidate at which it counts as offered [normalised]."""


def diagnosed(sessions: Sessions, tasks: Tasks, planner: Planner) -> Sessions:
    """The record with its fields `loss_recorded` and `offered` filled in, where the tasks have recorded manipulations.

    `loss_recorded` is the objective's value for the recorded manipulations from the first estimate, and `offered` tells
    whether the candidates of the first step include their grasp points. The recorded manipulations are relabelled to
    match the first estimates.
    """
    if tasks.recorded is None:
        return sessions
    representation = planner.representation
    goals = representation.of_meshes(sessions.goal)
    labels = labels_of_estimates(representation, sessions.estimate[:, 0], sessions.state[:, 0], sessions.cloth)
    loss, offered = sessions.loss_recorded.copy(), sessions.offered.copy()
    for length in np.unique(sessions.length).tolist():
        chosen = np.flatnonzero(sessions.length == length)
        plan = recorded_plans(representation, [tasks.recorded[task] for task in chosen], labels[chosen])
        estimate = sessions.estimate[chosen, 0]
        offers, cloth = sessions.candidates[chosen, 0], sessions.cloth[chosen]
        keys = search_keys(tasks, chosen, 0, planner.settings.seed)
        loss[chosen] = planning_losses(planner, estimate, goals[chosen], plan, cloth, offers, keys)
        wanted = representation.positions(estimate, plan[:, 0, :4].reshape(-1, 2, 2))
        offered[chosen] = [
            is_offered(wanted[i], _places(representation, estimate[i], sessions.candidates[task, 0]))
            for i, task in enumerate(chosen)
        ]
    return dataclasses.replace(sessions, loss_recorded=loss, offered=offered)


def labels_of_estimates(
    representation: Representation, estimates: States, truth: Meshes, cloth: Float[np.ndarray, "task 3"]
) -> Int[np.ndarray, " task"]:
    """The relabellings k that bring true states to the labels of their estimates, of cloths with these sides."""
    if representation.labels == 1:
        return np.zeros(len(estimates), np.int64)
    return np.asarray(_best_label(estimates, truth, cloth))


def recorded_plans(
    representation: Representation, recorded: Sequence[Stretch], labels: Int[np.ndarray, " task"]
) -> Float[np.ndarray, "task n 6"]:
    """The recorded manipulations of tasks of one length, relabelled to match the first estimates."""
    states, manipulations = (np.stack(parts) for parts in zip(*recorded, strict=True))
    return np.asarray(_relabelled(representation.recorded(states, manipulations).plan, labels))


def planning_losses(
    planner: Planner,
    states: States,
    goals: States,
    plans: Float[np.ndarray, "task n 6"],
    cloth: Float[np.ndarray, "task 3"],
    candidates: Float[np.ndarray, "task candidate 2"],
    keys: Keys,
) -> Float[np.ndarray, " task"]:
    """A planner's objective for one plan per task, in the labelling that fits it best (`losses`).

    `candidates` are those on the states; rows that are left over are NaN. `keys` are those of the tasks' searches.
    """
    longest, relative = planner.normalisation.longest, np.int32(0 if planner.labelled else UNKNOWN)
    objective = planner.objective(longest)
    covered = np.stack([planner.representation.covered(one) for one in states]) if objective.draws else None
    offers = Candidates(np.nan_to_num(candidates), np.isfinite(candidates[:, :, 0]).sum(1))
    value = partial(
        losses,
        planner.model,
        planner.representation,
        planner.nets,
        objective,
        relative,
        np.int32(plans.shape[1]),
    )
    return in_batches(
        value, planner.settings.batch, states, goals, padded(plans, longest), cloth, offers, covered, keys
    )


def _places(
    representation: Representation, estimate: Shaped[np.ndarray, "*state"], candidates: Float[np.ndarray, "c 2"]
) -> Float[np.ndarray, "present 2"]:
    present = np.isfinite(candidates[:, 0])
    # Padding is converted too, so that shapes are the same for all states and the function is compiled only once.
    pairs = np.repeat(np.nan_to_num(candidates)[:, None], 2, axis=1)
    return representation.positions(np.repeat(estimate[None], len(candidates), axis=0), pairs)[present, 0]


def is_offered(wanted: Float[np.ndarray, "2 2"], offers: Float[np.ndarray, "c 2"]) -> Bool[np.ndarray, ""]:
    """Whether every wanted grasp point has a candidate within NEAR; both arguments are xy [normalised]."""
    distance = np.linalg.norm(wanted[:, None] - offers, axis=-1)
    return np.asarray((distance.min(axis=1) <= NEAR).all())


@partial(jax.jit, static_argnames=("model", "representation"))
def losses(
    model: ForwardModel,
    representation: Representation,
    nets: tuple[Any, ...],
    objective: Objective,
    relative: Int[Array | np.ndarray, ""] | np.int32,
    steps: Int[Array | np.ndarray, ""] | np.int32,
    states: Shaped[Array, "task *state"],
    goals: Shaped[Array, "task *state"],
    plans: Float[Array, "task n 6"],
    cloths: Float[Array, "task 3"],
    offers: Candidates,
    covered: Bool[Array, "task x y"] | None,
    keys: Shaped[PRNGKeyArray, " task"],
) -> Float[Array, " task"]:
    """The objective's value for the first `steps` manipulations of one plan per task, `[task]`.

    It is the minimum over the common equivalents and, where `relative` is UNKNOWN, over the goal's relabellings. What
    the cloths cover is needed by terms that are posed with plans (`Objective.draws`). With the searches' `keys` these
    are posed with the plans that the searches pose them with, so that losses can be held against theirs.
    """
    count = representation.labels

    def one(
        state: Array,
        goal: Array,
        plan: Array,
        cloth: Array,
        offers: Candidates,
        covered: Array | None,
        key: PRNGKeyArray,
    ) -> Array:
        blank = [jax.eval_shape(model.encode, net, state) for net in nets]
        traces = tuple(jnp.zeros((count, *latent.shape)) for latent in blank)
        goal_label, first = jnp.asarray(relative), jnp.asarray(False)
        problem = Problem(state, goal, offers, traces, goal_label, first, plan, cloth, covered)
        posed = posed_objective(objective, model, representation, nets, problem, len(plan), key)
        relabelled = jax.vmap(equivalents_of_manipulation, out_axes=1)(plan)[:count]
        found = evaluate(
            posed,
            model,
            representation,
            nets,
            fix(model, representation, nets, problem),
            relabelled,
            jnp.arange(count),
            jnp.full(count, relative),
            steps=jnp.asarray(steps),
        )
        return jnp.min(found.loss)

    return jax.vmap(one)(states, goals, plans, cloths, offers, covered, keys)


_relabelled = jax.jit(relabel_manipulation_batch)
_best_label = jax.jit(lambda mesh, truth, cloth: best_label(mesh, truth, cloth=cloth))
