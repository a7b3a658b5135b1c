"""What the nets expect of a found plan, and the memory traces that it leaves (section 5.1)."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped

from clothkit.cloth.equivalents import INVERSE, equivalents_of_manipulation, relabel_manipulation
from clothkit.planning.forward import Forward, unroll


class Expected(NamedTuple):
    """What one net predicts for a plan, in the labels of the state."""

    states: Any
    """Predictions [n ..]: after each manipulation."""
    traces: Float[Array, "labels latent"]
    """The memory trace that the first manipulation leaves in each common equivalent."""


@partial(jax.jit, static_argnames="forward")
def expect(
    forward: Forward,
    nets: tuple[Any, ...],
    state: Shaped[Array | np.ndarray, "tasks *state"],
    traces: tuple[Float[Array | np.ndarray, "tasks labels latent"], ...],
    plan: Float[Array | np.ndarray, "tasks n 6"],
    common: Int[Array | np.ndarray, " tasks"],
) -> tuple[Expected, ...]:
    """Each net's expectation of each task's plan, predicted in the common equivalent in which the plan was found."""

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
