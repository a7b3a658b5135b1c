"""Augmentation in the training step: rotation, mirroring, equivalents, swapped grasps and vertex noise (4.6 and 4.8).

Null manipulations are not inserted here: data/augmented.zarr contains them already (design.md section 4).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from clothkit.cloth import equivalents
from clothkit.cloth.equivalents import relabel_batch, relabel_manipulation_batch
from clothkit.manipulation.turns import planar, turn_manipulation, turn_mesh
from clothkit.manipulation.vector import swap_grasps
from clothkit.models.canonical import frame


class Examples(NamedTuple):
    """A batch of subsequences of n manipulations: inputs and targets of pEM*D [normalised]."""

    mesh: Float[Array, "batch u v 3"]
    """The first state, centred: the input."""
    manipulations: Float[Array, "batch n 6"]
    outcomes: Float[Array, "batch n u v 3"]
    """The state after each manipulation, centred."""
    shifts: Float[Array, "batch n 2"]
    """The displacement of the cloth's centre by each manipulation."""


def random_turns(batch: int, *, key: PRNGKeyArray) -> Float[Array, "batch 2 2"]:
    """Random isometries of the plane: rotations by a uniform angle, mirrored with probability 1/2."""
    angle_key, mirror_key = jax.random.split(key)
    angle = jax.random.uniform(angle_key, (batch,), maxval=2 * jnp.pi)
    return planar(angle, jax.random.bernoulli(mirror_key, shape=(batch,)))


def turned(examples: Examples, matrices: Float[Array, "batch 2 2"]) -> Examples:
    """The examples, each rotated or mirrored about z by its matrix."""
    per_step = jnp.broadcast_to(matrices[:, None], (*examples.shifts.shape, 2))
    return Examples(
        mesh=turn_mesh(examples.mesh, matrices),
        manipulations=turn_manipulation(examples.manipulations, per_step),
        outcomes=turn_mesh(examples.outcomes, per_step),
        shifts=jnp.sum(per_step * examples.shifts[..., None, :], axis=-1),
    )


def relabelled(examples: Examples, k: Array) -> Examples:
    """The examples (inputs, outcomes and grasp points), each under the labels of its equivalent k, int [batch]."""
    return Examples(
        mesh=relabel_batch(examples.mesh, k),
        manipulations=relabel_manipulation_batch(examples.manipulations, k),
        outcomes=relabel_batch(examples.outcomes, k),
        shifts=examples.shifts,
    )


def examples_described(examples: Examples) -> Examples:
    """The examples, each transformed to the canonical description of its first state."""
    found = frame(examples.mesh)
    return relabelled(turned(examples, found.matrix), found.k)


def augment(examples: Examples, *, noise: float, key: PRNGKeyArray) -> Examples:
    """Randomly transformed examples, with normal noise of that standard deviation [normalised] on the input mesh only.

    Each example is rotated or mirrored and gets the labels of a random equivalent; the two grasp points of each
    manipulation are swapped with probability 1/2.
    """
    turn_key, label_key, swap_key, noise_key = jax.random.split(key, 4)
    batch, n = examples.manipulations.shape[:2]
    examples = turned(examples, random_turns(batch, key=turn_key))
    examples = relabelled(examples, jax.random.randint(label_key, (batch,), 0, equivalents.COUNT))
    swap = jax.random.bernoulli(swap_key, shape=(batch, n, 1))
    manipulations = jnp.where(swap, swap_grasps(examples.manipulations), examples.manipulations)
    mesh = examples.mesh + noise * jax.random.normal(noise_key, examples.mesh.shape) if noise else examples.mesh
    return examples._replace(mesh=mesh, manipulations=manipulations)
