"""What the nets expect of a found plan, and the memory traces that it leaves (section 5.1)."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from clothkit.cloth.equivalents import equivalents, equivalents_of_manipulation, relabel, relabel_manipulation
from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.planning.forward import Forward, unroll
from clothkit.planning.search import INVERSE


class Expected(NamedTuple):
    """What one net predicts for a plan, in the labels of the estimate."""

    states: ProbabilisticMesh
    """[n u v 3]: after each manipulation."""
    traces: Float[Array, "8 latent"]
    """The memory trace that the first manipulation leaves in each common equivalent."""


@partial(jax.jit, static_argnames="forward")
def expect(
    forward: Forward,
    nets: tuple[Any, ...],
    mesh: Float[Array | np.ndarray, "tasks u v 3"],
    traces: tuple[Float[Array | np.ndarray, "tasks 8 latent"], ...],
    plan: Float[Array | np.ndarray, "tasks n 6"],
    common: Int[Array | np.ndarray, " tasks"],
) -> tuple[Expected, ...]:
    """Each net's expectation of each task's plan, predicted in the common equivalent in which the plan was found."""

    def one(net: Any, mesh: Array, traces: Array, plan: Array, common: Array) -> Expected:
        latents = forward.encode(net, equivalents(mesh))
        rollout = unroll(forward, net, latents[common], traces[common], relabel_manipulation(plan, common))
        states = forward.decode(net, rollout.latents, 1)
        back = jnp.asarray(INVERSE)[common]
        states = ProbabilisticMesh(*(relabel(part, back) for part in states))
        _, left, _ = forward.step(net, latents, traces, equivalents_of_manipulation(plan[0]))
        return Expected(states, left)

    mesh, plan, common = jnp.asarray(mesh), jnp.asarray(plan), jnp.asarray(common)
    return tuple(
        jax.vmap(partial(one, net))(mesh, jnp.asarray(trace), plan, common)
        for net, trace in zip(nets, traces, strict=True)
    )
