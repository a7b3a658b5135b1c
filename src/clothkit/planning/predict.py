"""The nets' predictions for a plan, and the memory traces after its first manipulation (section 5.1)."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped

from clothkit.cloth.symmetry import equivalents_of_manipulation, relabel_manipulation
from clothkit.cloth.topology import SQUARE
from clothkit.models.forward import ForwardModel, rollout
from clothkit.planning.objective import mean_difference
from clothkit.planning.representation import Representation


class Prediction(NamedTuple):
    """One net's predictions for a plan, in the labels of the initial state."""

    states: Any
    """Predictions [n ..] of the state after each manipulation."""
    shifts: Float[Array, "n 2"]
    """The shift of the cloth's centre by each manipulation [normalised]."""
    traces: Float[Array, "labels latent"]
    """The memory trace after the first manipulation, for each common equivalent."""


@partial(jax.jit, static_argnames=("model", "representation"))
def predict(
    model: ForwardModel,
    representation: Representation,
    nets: tuple[Any, ...],
    state: Shaped[Array | np.ndarray, "tasks *state"],
    traces: tuple[Float[Array | np.ndarray, "tasks labels latent"], ...],
    plan: Float[Array | np.ndarray, "tasks n 6"],
    common: Int[Array | np.ndarray, " tasks"],
) -> tuple[Prediction, ...]:
    """Each net's predictions for the plan of each task; arrays in the result have a leading axis of tasks.

    The states are predicted in the common equivalent in which the search found the plan, and then relabelled back.
    """

    def one(net: Any, state: Array, traces: Array, plan: Array, common: Array) -> Prediction:
        latents = model.encode(net, representation.equivalents(state))
        found = rollout(model, net, latents[common], relabel_manipulation(plan, common), traces[common])
        states = model.decode(net, found.latents)
        states = representation.relabel_prediction(states, jnp.asarray(SQUARE.inverses)[common])
        manipulations = equivalents_of_manipulation(plan[0])[: representation.labels]
        _, left, _ = model.step(net, latents, traces, manipulations)
        return Prediction(states, found.shifts, left)

    state, plan, common = jnp.asarray(state), jnp.asarray(plan), jnp.asarray(common)
    return tuple(
        jax.vmap(partial(one, net))(state, jnp.asarray(trace), plan, common)
        for net, trace in zip(nets, traces, strict=True)
    )


@partial(jax.jit, static_argnames="representation")
def differences(representation: Representation, predictions: tuple[Prediction, ...]) -> Float[Array, "tasks n"] | None:
    """diff of eq. (15) after each manipulation, in the mean over all pairs of nets; None for a single net."""
    return mean_difference(representation, [prediction.states for prediction in predictions])
