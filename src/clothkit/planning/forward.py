"""What a search asks of a forward model and of the states that it predicts, for any net and representation."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from clothkit.cloth import equivalents as symmetry
from clothkit.cloth.equivalents import COUNT
from clothkit.cloth.grid import thinned
from clothkit.cloth.mesh import ProbabilisticMesh, whiten
from clothkit.manipulation.geometry import to_cartesian
from clothkit.networks import pemd
from clothkit.planning import loss


def points(state: Float[Array, "u v 3"], grasps: Float[Array, "*points 2"]) -> Float[Array, "*points 2"]:
    """Where geodesic grasp points lie on a mesh, xy [normalised]."""
    return to_cartesian(jnp.broadcast_to(state, (*grasps.shape[:-1], *state.shape)), grasps)[..., :2]


def relabelled(prediction: ProbabilisticMesh, k: Int[Array, ""]) -> ProbabilisticMesh:
    """A predicted mesh under the labels of equivalent k."""
    return ProbabilisticMesh(*(symmetry.relabel(part, k) for part in prediction))


class Forward(NamedTuple):
    """A forward model as pure functions, and how its states are labelled and compared; by default as meshes are.

    A state is what the net encodes, `[*state]`: a mesh [u v 3], or voxels [x y z]. A prediction is what it decodes.
    """

    encode: Callable[..., Any]
    """net, states [*b *state] -> latents [*b latent], eq. (2)"""
    step: Callable[..., Any]
    """net, latents, traces [*b latent], manipulations [*b 6] -> latents, traces, centre shifts [*b 2], eq. (3)"""
    decode: Callable[..., Any]
    """net, latents, every -> predictions; of meshes one of every `every` vertices along u and v, eq. (4)"""
    labels: int = COUNT
    """How many labellings describe one state: eight equivalents, or one where a state has no labels."""
    equivalents: Callable[..., Any] = symmetry.equivalents
    """state -> [labels *state]"""
    relabelled: Callable[..., Any] = relabelled
    """prediction, k -> the prediction under the labels of equivalent k"""
    points: Callable[..., Any] = points
    """state, grasp points [*p 2] -> xy [*p 2], normalised"""
    target: Callable[..., Any] = whiten
    """goals, thinned or not [*g *state] -> goals as the losses take them"""
    thinned: Callable[..., Any] = thinned
    """goals, every -> what of them thinned predictions are compared with"""
    accuracy: Callable[..., Any] = loss.accuracy
    """goals, predictions, span -> accuracy terms of eq. (13) [*b]"""
    accuracy_of_each: Callable[..., Any] = loss.accuracy_of_each
    """goals [g ..], predictions [b ..], span -> accuracy terms [b g]"""
    diff: Callable[..., Any] = loss.diff
    """predictions of two nets -> how far they differ, eq. (15) [*b]"""


MESH = Forward(pemd.encode, pemd.step, pemd.decode)


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
