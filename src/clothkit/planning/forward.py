"""The interface between a search and a forward model, for any net and any representation of states."""

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
from clothkit.models import pemd
from clothkit.planning import loss


def points(state: Float[Array, "u v 3"], grasps: Float[Array, "*points 2"]) -> Float[Array, "*points 2"]:
    """The positions xy [normalised] of geodesic grasp points on a mesh."""
    return to_cartesian(jnp.broadcast_to(state, (*grasps.shape[:-1], *state.shape)), grasps)[..., :2]


def relabelled(prediction: ProbabilisticMesh, k: Int[Array, ""]) -> ProbabilisticMesh:
    """A predicted mesh under the labels of equivalent k."""
    return ProbabilisticMesh(*(symmetry.relabel(part, k) for part in prediction))


class Forward(NamedTuple):
    """A forward model as pure functions, together with the labelling and the losses of its states.

    The defaults are those of meshes. A state, of shape `*state`, is the net's input: a mesh [u v 3], or voxels [x y z].
    A prediction is the output of `decode`.
    """

    encode: Callable[..., Any]
    """net, states [*b *state] -> latents [*b latent], eq. (2)"""
    step: Callable[..., Any]
    """net, latents, traces [*b latent], manipulations [*b 6] -> latents, traces, centre shifts [*b 2], eq. (3)"""
    decode: Callable[..., Any]
    """net, latents, every -> predictions, eq. (4); of a mesh only every `every`-th vertex along u and v"""
    labels: int = COUNT
    """Number of labellings of one state: eight equivalents, or one if states have no labels."""
    equivalents: Callable[..., Any] = symmetry.equivalents
    """state -> [labels *state]"""
    relabelled: Callable[..., Any] = relabelled
    """prediction, k -> the prediction under the labels of equivalent k"""
    points: Callable[..., Any] = points
    """state, grasp points [*p 2] -> xy [*p 2], normalised"""
    target: Callable[..., Any] = whiten
    """goals [*g *state], thinned or not -> goals in the form that the losses take"""
    thinned: Callable[..., Any] = thinned
    """goals, every -> the part of the goals that predictions decoded with the same `every` are compared with"""
    accuracy: Callable[..., Any] = loss.accuracy
    """goals, predictions, span -> accuracy terms of eq. (13) [*b]"""
    accuracy_of_each: Callable[..., Any] = loss.accuracy_of_each
    """goals [g ..], predictions [b ..], span -> accuracy terms [b g]"""
    diff: Callable[..., Any] = loss.diff
    """predictions of two nets -> their difference, eq. (15) [*b]"""


MESH = Forward(pemd.encode, pemd.step, pemd.decode)


class Rollout(NamedTuple):
    """The latents and memory traces after each of a plan's n manipulations."""

    latents: Float[Array, "n *batch latent"]
    traces: Float[Array, "n *batch latent"]


def unroll(
    forward: Forward,
    net: Any,
    latent: Float[Array, "*batch latent"],
    trace: Float[Array, "*batch latent"],
    plan: Float[Array, "*batch n 6"],
) -> Rollout:
    """Eq. (5) without the decoder: M is applied once per manipulation of the plan."""

    def step(state: tuple[Array, Array], manipulation: Array) -> tuple[tuple[Array, Array], Rollout]:
        latent, trace, _ = forward.step(net, *state, manipulation)
        return (latent, trace), Rollout(latent, trace)

    # A scan compiles M once instead of n times, and M takes most of the compilation time.
    return jax.lax.scan(step, (latent, trace), jnp.moveaxis(plan, -2, 0))[1]
