"""Forward models as planning uses them: E, M and D as pure functions of a net, and the rollout of a plan."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from clothkit.models import emd_voxel, pemd


class ForwardModel(NamedTuple):
    """E, M and D of a kind of net."""

    encode: Callable[..., Any]
    """net, states [*b *state] -> latents [*b latent], eq. (2)"""
    step: Callable[..., Any]
    """net, latents, traces [*b latent], manipulations [*b 6] -> latents, traces, centre shifts [*b 2], eq. (3)"""
    decode: Callable[..., Any]
    """net, latents, stride -> predictions, eq. (4); of a mesh only every `stride`-th vertex along u and v"""


PEMD = ForwardModel(pemd.encode, pemd.step, pemd.decode)
EMD_VOXEL = ForwardModel(emd_voxel.encode, emd_voxel.step, lambda net, latent, stride: emd_voxel.logits(net, latent))


class Rollout(NamedTuple):
    """The latents, memory traces and centre shifts after each of a plan's n manipulations."""

    latents: Float[Array, "n *batch latent"]
    traces: Float[Array, "n *batch latent"]
    shifts: Float[Array, "n *batch 2"]


def rollout(
    model: ForwardModel,
    net: Any,
    latent: Float[Array, "*batch latent"],
    trace: Float[Array, "*batch latent"],
    plan: Float[Array, "*batch n 6"],
) -> Rollout:
    """Eq. (5) without the decoder: M is applied once per manipulation of the plan."""

    def step(state: tuple[Array, Array], manipulation: Array) -> tuple[tuple[Array, Array], Rollout]:
        latent, trace, shift = model.step(net, *state, manipulation)
        return (latent, trace), Rollout(latent, trace, shift)

    # A scan compiles M once instead of n times, and M takes most of the compilation time.
    return jax.lax.scan(step, (latent, trace), jnp.moveaxis(plan, -2, 0))[1]
