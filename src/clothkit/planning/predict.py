"""The nets' predictions for a plan, and the memory traces after its first manipulation (section 5.1)."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped

from clothkit.cloth.equivalents import INVERSE, equivalents_of_manipulation, relabel_manipulation
from clothkit.planning.forward import Forward, unroll


class Expected(NamedTuple):
    """One net's predictions for a plan, in the labels of the initial state."""

    states: Any
    """Predictions [n ..] of the state after each manipulation."""
    traces: Float[Array, "labels latent"]
    """The memory trace after the first manipulation, for each common equivalent."""


@partial(jax.jit, static_argnames="forward")
def expect(
    forward: Forward,
    nets: tuple[Any, ...],
    state: Shaped[Array | np.ndarray, "tasks *state"],
    traces: tuple[Float[Array | np.ndarray, "tasks labels latent"], ...],
    plan: Float[Array | np.ndarray, "tasks n 6"],
    common: Int[Array | np.ndarray, " tasks"],
) -> tuple[Expected, ...]:
    """Each net's predictions for the plan of each task; arrays in the result have a leading axis of tasks.

    The states are predicted in the common equivalent in which the search found the plan, and then relabelled back.
    """

    def one(net: Any, state: Array, traces: Array, plan: Array, common: Array) -> Expected:
        latents = forward.encode(net, forward.equivalents(state))
        rollout = unroll(forward, net, latents[common], traces[common], relabel_manipulation(plan, common))
        states = forward.relabelled(forward.decode(net, rollout.latents, 1), jnp.asarray(INVERSE)[common])
        manipulations = equivalents_of_manipulation(plan[0])[: forward.labels]
        _, left, _ = forward.step(net, latents, traces, manipulations)
        return Expected(states, left)

    state, plan, common = jnp.asarray(state), jnp.asarray(plan), jnp.asarray(common)
    return tuple(
        jax.vmap(partial(one, net))(state, jnp.asarray(trace), plan, common)
        for net, trace in zip(nets, traces, strict=True)
    )
