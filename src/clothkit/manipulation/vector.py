"""Manipulations as 6-vectors: u1 v1 u2 v2 (geodesic), dx dy (normalised, Cartesian) (section 4.2.2)."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy import ndarray

from clothkit.cloth.topology import CLOTH_LENGTH

SHORTEST = 0.35 * CLOTH_LENGTH
"""A manipulation with a shorter displacement is null [normalised]."""

Manipulations = Float[Array, "*batch 6"] | Float[ndarray, "*batch 6"]


def grasp_points(manipulation: Manipulations) -> tuple[Array | ndarray, Array | ndarray]:
    """The two grasp points, geodesic, [*batch, 2] each; they are equal for one hand."""
    return manipulation[..., 0:2], manipulation[..., 2:4]


def displacement(manipulation: Manipulations) -> Array | ndarray:
    """The displacement vector, Cartesian [normalised], [*batch, 2]."""
    return manipulation[..., 4:6]


def is_null(manipulation: Manipulations) -> Bool[Array, "*batch"] | Bool[ndarray, "*batch"]:
    """Whether the displacement is shorter than `SHORTEST`, so that the manipulation is null (4.4, restriction 3).

    Arrays are NumPy or JAX, as the argument is.
    """
    xp = jnp if isinstance(manipulation, Array) else np
    return xp.asarray(xp.sum(displacement(manipulation) ** 2, axis=-1) < SHORTEST**2)


def is_single(manipulation: Manipulations) -> Bool[Array, "*batch"] | Bool[ndarray, "*batch"]:
    """Whether the manipulation is one-handed: its two grasp points are equal. NumPy or JAX, as the argument is."""
    xp = jnp if isinstance(manipulation, Array) else np
    first, second = grasp_points(manipulation)
    return xp.asarray(xp.all(first == second, axis=-1))


def swap_grasps(manipulation: Manipulations) -> Float[Array, "*batch 6"]:
    """The same manipulation with its grasp points exchanged (section 4.6, augmentation 3)."""
    return jnp.asarray(manipulation)[..., jnp.array([2, 3, 0, 1, 4, 5])]
