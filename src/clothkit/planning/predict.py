"""The nets' predictions for a plan, and the memory traces after its first manipulation (section 5.1)."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped

from clothkit.cloth.symmetry import equivalent_cloths, equivalents_of_manipulation, relabel_manipulation
from clothkit.cloth.topology import SQUARE
from clothkit.dataset.store import STEPS
from clothkit.models.forward import ForwardModel, rollout
from clothkit.planning.objective import mean_difference
from clothkit.planning.representation import Representation


class Prediction(NamedTuple):
    """One net's predictions for a plan, in the labels of the initial state."""

    states: Any
    """Predictions [n ..] of the state after each manipulation."""
    shifts: Float[Array | np.ndarray, "n 2"]
    """The shift of the cloth's centre by each manipulation [normalised]."""
    traces: Float[Array | np.ndarray, "labels latent"]
    """The memory trace after the first manipulation, for each common equivalent."""


def predict(
    model: ForwardModel,
    representation: Representation,
    nets: tuple[Any, ...],
    state: Shaped[Array | np.ndarray, "tasks *state"],
    traces: tuple[Float[Array | np.ndarray, "tasks labels latent"], ...],
    plan: Float[Array | np.ndarray, "tasks n 6"],
    common: Int[Array | np.ndarray, " tasks"],
    cloth: Float[Array | np.ndarray, "tasks 3"],
) -> tuple[Prediction, ...]:
    """Each net's predictions for the plan of each task; arrays in the result have a leading axis of tasks.

    The states are predicted in the common equivalent in which the search found the plan, and then relabelled back.
    """
    length = plan.shape[1]
    found = []
    for net, trace in zip(nets, traces, strict=True):
        states, shifts, left = _predict(model, representation, net, state, trace, padded(plan, STEPS), common, cloth)
        states, shifts = jax.tree.map(lambda part: np.asarray(part)[:, :length], (states, shifts))
        found.append(Prediction(states, shifts, left))
    return tuple(found)


def padded(plan: Float[Array | np.ndarray, "tasks n 6"], length: int) -> Float[np.ndarray, "tasks padded 6"]:
    """Plans with zeros appended, so that a program serves plans of any length. No state depends on later manipulations.

    Raises ValueError for longer plans.
    """
    return np.pad(np.asarray(plan), ((0, 0), (0, length - plan.shape[1]), (0, 0)))


@partial(jax.jit, static_argnames=("model", "representation"))
def _predict(
    model: ForwardModel,
    representation: Representation,
    net: Any,
    state: Shaped[Array | np.ndarray, "tasks *state"],
    traces: Float[Array | np.ndarray, "tasks labels latent"],
    plan: Float[Array | np.ndarray, "tasks n 6"],
    common: Int[Array | np.ndarray, " tasks"],
    cloth: Float[Array | np.ndarray, "tasks 3"],
) -> Prediction:
    """One net's predictions, by a program that serves all nets and systems."""

    def one(state: Array, traces: Array, plan: Array, common: Array, cloth: Array) -> Prediction:
        cloths = equivalent_cloths(cloth)[: representation.labels]
        latents = model.encode(net, representation.equivalents(state), cloths)
        found = rollout(model, net, latents[common], relabel_manipulation(plan, common), traces[common])
        states = model.decode(net, found.latents)
        states = representation.relabel_prediction(states, jnp.asarray(SQUARE.inverses)[common])
        manipulations = equivalents_of_manipulation(plan[0])[: representation.labels]
        _, left, _ = model.step(net, latents, traces, manipulations)
        return Prediction(states, found.shifts, left)

    return jax.vmap(one)(*(jnp.asarray(part) for part in (state, traces, plan, common, cloth)))


@partial(jax.jit, static_argnames="representation")
def differences(representation: Representation, predictions: tuple[Prediction, ...]) -> Float[Array, "tasks n"] | None:
    """diff of eq. (15) after each manipulation, in the mean over all pairs of nets; None for a single net."""
    return mean_difference(representation, [prediction.states for prediction in predictions])
