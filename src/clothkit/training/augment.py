"""Augmentation in the training step: rotation, mirroring, equivalents, swapped grasps and vertex noise (4.6 and 4.8).

Null manipulations are not inserted here: data/augmented.zarr contains them already (design.md section 4).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, Shaped

from clothkit.cloth.symmetry import relabel_batch, relabel_cloth, relabel_manipulation_batch
from clothkit.cloth.topology import SQUARE
from clothkit.manipulation.turns import planar, turn, turn_manipulation, turn_mesh
from clothkit.manipulation.vector import swap_grasps
from clothkit.models.canonical import Canonicalised, Description
from clothkit.models.forward import ForwardModel


class Examples(NamedTuple):
    """A batch of subsequences of n manipulations: inputs and targets of a forward model [normalised].

    States are meshes [u v 3] or voxels [x y z], as are the grasp points geodesic or Cartesian.
    """

    state: Shaped[Array, "batch *state"]
    """The first state, centred: the input."""
    manipulations: Float[Array, "batch n 6"]
    outcomes: Shaped[Array, "batch n *state"]
    """The state after each manipulation, centred."""
    shifts: Float[Array, "batch n 2"]
    """The displacement of the cloth's centre by each manipulation."""
    cloth: Float[Array, "batch 3"]
    """Sides and thickness, in the labels of the first state."""


def random_turns(batch: int, *, key: PRNGKeyArray) -> Float[Array, "batch 2 2"]:
    """Random isometries of the plane: rotations by a uniform angle, mirrored with probability 1/2."""
    angle_key, mirror_key = jax.random.split(key)
    angle = jax.random.uniform(angle_key, (batch,), maxval=2 * jnp.pi)
    return planar(angle, jax.random.bernoulli(mirror_key, shape=(batch,)))


def turned(examples: Examples, matrices: Float[Array, "batch 2 2"]) -> Examples:
    """Examples in meshes, each rotated or mirrored about z by its matrix."""
    per_step = jnp.broadcast_to(matrices[:, None], (*examples.shifts.shape, 2))
    return Examples(
        state=turn_mesh(examples.state, matrices),
        manipulations=turn_manipulation(examples.manipulations, per_step),
        outcomes=turn_mesh(examples.outcomes, per_step),
        shifts=jnp.sum(per_step * examples.shifts[..., None, :], axis=-1),
        cloth=examples.cloth,
    )


def relabelled(examples: Examples, k: Array) -> Examples:
    """Examples in meshes (states and grasp points), each under the labels of its equivalent k, int [batch]."""
    return Examples(
        state=relabel_batch(examples.state, k),
        manipulations=relabel_manipulation_batch(examples.manipulations, k),
        outcomes=relabel_batch(examples.outcomes, k),
        shifts=examples.shifts,
        cloth=relabel_cloth(examples.cloth, k),
    )


def described(examples: Examples, description: Description) -> Examples:
    """The examples, each transformed to the canonical description of its first state."""
    found = description.frame(examples.state, examples.cloth)
    per_step = jax.tree.map(lambda part: jnp.repeat(part[:, None], examples.shifts.shape[1], axis=1), found)
    return Examples(
        state=description.state(examples.state, found),
        manipulations=description.manipulation(examples.manipulations, per_step),
        outcomes=description.state(examples.outcomes, per_step),
        shifts=turn(examples.shifts, per_step.matrix),
        cloth=relabel_cloth(examples.cloth, found.k),
    )


def as_shown(model: ForwardModel, examples: Examples) -> tuple[ForwardModel, Examples]:
    """The model that learns from examples, and the examples in the descriptions that are its inputs and outputs."""
    if isinstance(model, Canonicalised):
        return model.model, described(examples, model.description)
    return model, examples


def augment(examples: Examples, *, noise: float, key: PRNGKeyArray) -> Examples:
    """Randomly transformed examples in meshes, with normal noise of that deviation [normalised] on the input only.

    Each example is rotated or mirrored and gets the labels of a random equivalent; the two grasp points of each
    manipulation are swapped with probability 1/2.
    """
    turn_key, label_key, swap_key, noise_key = jax.random.split(key, 4)
    batch, n = examples.manipulations.shape[:2]
    examples = turned(examples, random_turns(batch, key=turn_key))
    examples = relabelled(examples, jax.random.randint(label_key, (batch,), 0, SQUARE.count))
    swap = jax.random.bernoulli(swap_key, shape=(batch, n, 1))
    manipulations = jnp.where(swap, swap_grasps(examples.manipulations), examples.manipulations)
    mesh = examples.state + noise * jax.random.normal(noise_key, examples.state.shape) if noise else examples.state
    return examples._replace(state=mesh, manipulations=manipulations)
