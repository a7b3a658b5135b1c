"""Augmentation inside the training step (sections 4.6 and 4.8): turns, mirrors, equivalents, swaps and vertex noise.

Null manipulations are not inserted here: they are in data/augmented.zarr already (design.md section 4).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from clothkit.cloth import equivalents
from clothkit.cloth.equivalents import relabel_batch, relabel_manipulation_batch
from clothkit.manipulation.turns import planar, turn_manipulation, turn_mesh
from clothkit.manipulation.vector import swap_grasps
from clothkit.networks.canonical import frame


class Examples(NamedTuple):
    """Stretches of n manipulations, as pEM*D takes and predicts them [normalised]."""

    mesh: Float[Array, "batch u v 3"]
    """The first state: the input."""
    manipulations: Float[Array, "batch n 6"]
    outcomes: Float[Array, "batch n u v 3"]
    """The state after each manipulation, centred."""
    shifts: Float[Array, "batch n 2"]
    """How far each manipulation moved the centre."""


def random_turns(batch: int, *, key: PRNGKeyArray) -> Float[Array, "batch 2 2"]:
    """Random isometries of the plane: a uniform angle, mirrored half of the time."""
    angle_key, mirror_key = jax.random.split(key)
    angle = jax.random.uniform(angle_key, (batch,), maxval=2 * jnp.pi)
    return planar(angle, jax.random.bernoulli(mirror_key, shape=(batch,)))


def turned(examples: Examples, matrices: Float[Array, "batch 2 2"]) -> Examples:
    """The same stretches on a turned or mirrored table."""
    per_step = jnp.broadcast_to(matrices[:, None], (*examples.shifts.shape, 2))
    return Examples(
        mesh=turn_mesh(examples.mesh, matrices),
        manipulations=turn_manipulation(examples.manipulations, per_step),
        outcomes=turn_mesh(examples.outcomes, per_step),
        shifts=jnp.sum(per_step * examples.shifts[..., None, :], axis=-1),
    )


def relabelled(examples: Examples, k: Array) -> Examples:
    """The same stretches under the labels of equivalent k, int [batch]: input, outcomes and grasp points alike."""
    return Examples(
        mesh=relabel_batch(examples.mesh, k),
        manipulations=relabel_manipulation_batch(examples.manipulations, k),
        outcomes=relabel_batch(examples.outcomes, k),
        shifts=examples.shifts,
    )


def examples_described(examples: Examples) -> Examples:
    """The stretches in the canonical descriptions of their first states."""
    found = frame(examples.mesh)
    return relabelled(turned(examples, found.matrix), found.k)


def augment(examples: Examples, *, noise: float, key: PRNGKeyArray) -> Examples:
    """Other descriptions of the same stretches; normal noise [normalised] on the input's coordinates only."""
    turn_key, label_key, swap_key, noise_key = jax.random.split(key, 4)
    batch, n = examples.manipulations.shape[:2]
    examples = turned(examples, random_turns(batch, key=turn_key))
    examples = relabelled(examples, jax.random.randint(label_key, (batch,), 0, equivalents.COUNT))
    swap = jax.random.bernoulli(swap_key, shape=(batch, n, 1))
    manipulations = jnp.where(swap, swap_grasps(examples.manipulations), examples.manipulations)
    mesh = examples.mesh + noise * jax.random.normal(noise_key, examples.mesh.shape) if noise else examples.mesh
    return examples._replace(mesh=mesh, manipulations=manipulations)
