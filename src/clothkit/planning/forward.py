"""What a search asks of a forward model: encode, step and decode, for any net that has them."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from clothkit.cloth.grid import SIDE
from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.networks import pemd
from clothkit.networks.layers import LEAST_STD
from clothkit.networks.net import Net


class Forward(NamedTuple):
    """The three modules of a forward model as pure functions whose first argument is the net (eqs. 2 to 4)."""

    encode: Callable[..., Any]
    """net, meshes [*b u v 3] -> latents [*b latent]"""
    step: Callable[..., Any]
    """net, latents, traces [*b latent], manipulations [*b 6] -> latents, traces, centre shifts [*b 2]"""
    decode: Callable[..., Any]
    """net, latents, every -> ProbabilisticMesh [*b u/every v/every 3], each `every`-th vertex along u and v"""


def decode_thinned(net: Net, latent: Float[Array, "*batch latent"], every: int) -> ProbabilisticMesh:
    """`pemd.decode`'s output at every `every`-th vertex along u and v, at the cost of these vertices only.

    Most of a search's arithmetic is the decoder's last layer, and neighbouring vertices tell nearly the same.
    """
    if every == 1:
        return pemd.decode(net, latent)
    decoder = net.params["D"]
    units = latent
    for i in range(len(net.config.decoder)):
        layer = decoder[f"layer_{i + 1}"]
        units = jnp.tanh(units @ layer["kernel"] + layer["bias"])
    kernel, bias = (
        decoder["mesh"][name].reshape(-1, SIDE, SIDE, 6)[:, ::every, ::every] for name in ("kernel", "bias")
    )
    side = SIDE // every
    units = units @ kernel.reshape(len(kernel), -1) + bias.reshape(-1)
    units = units.reshape(*units.shape[:-1], side, side, 6)
    return ProbabilisticMesh(units[..., :3], jnp.exp(units[..., 3:]) + LEAST_STD)


MESH = Forward(pemd.encode, pemd.step, decode_thinned)


class Rollout(NamedTuple):
    """Where a plan leads in latent space: latents and memory traces after each of n manipulations."""

    latents: Float[Array, "n *batch latent"]
    traces: Float[Array, "n *batch latent"]


def unroll(
    forward: Forward,
    net: Any,
    latent: Float[Array, "*batch latent"],
    trace: Float[Array, "*batch latent"],
    plan: Float[Array, "*batch n 6"],
) -> Rollout:
    """Eq. (5) without its decoder: M applied once per manipulation of the plan."""

    def step(state: tuple[Array, Array], manipulation: Array) -> tuple[tuple[Array, Array], Rollout]:
        latent, trace, _ = forward.step(net, *state, manipulation)
        return (latent, trace), Rollout(latent, trace)

    # A loop, not n copies: M is most of what there is to compile.
    return jax.lax.scan(step, (latent, trace), jnp.moveaxis(plan, -2, 0))[1]
