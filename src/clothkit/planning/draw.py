"""Random plans: where each strain of a search starts from (section 5.1, design 6.2 and 6.9).

Grasp points are in the coordinates in which the net takes them: geodesic, or Cartesian for the voxel baseline. `xy` is
where they lie on the table, which is what geometry is about.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from clothkit.manipulation.geometry import release_points

REACH = 1.4
"""Displacements are drawn from -REACH..REACH in x and y [normalised]."""

SINGLE_SHARE = 1 / 3
"""Probability of one hand."""

FIRST_STEP_DRAWS = 16
"""Draws of a first manipulation among which the first valid one is taken."""


class Candidates(NamedTuple):
    """Grasp points of one state, padded to a fixed number so that every task has the same shapes."""

    grasps: Float[Array, "candidates 2"] | Float[np.ndarray, "candidates 2"]
    present: Int[Array, ""] | Int[np.ndarray, ""] | int


def random_manipulations(shape: tuple[int, ...], *, key: PRNGKeyArray) -> Float[Array, "*shape 6"]:
    """Manipulations without the restrictions of data generation; one hand is the same grasp point twice."""
    key_grasps, key_displacement, key_hands = jax.random.split(key, 3)
    grasps = jax.random.uniform(key_grasps, (*shape, 4), minval=-1, maxval=1)
    displacement = jax.random.uniform(key_displacement, (*shape, 2), minval=-REACH, maxval=REACH)
    single = jax.random.uniform(key_hands, shape) < SINGLE_SHARE
    second = jnp.where(single[..., None], grasps[..., :2], grasps[..., 2:])
    return jnp.concatenate([grasps[..., :2], second, displacement], axis=-1)


def random_plans(
    strains: int,
    steps: int,
    candidates: Candidates,
    xy: Float[Array, "candidates 2"],
    *,
    key: PRNGKeyArray,
) -> Float[Array, "strains n 6"]:
    """Random plans whose first grasp points are candidates; these lie at `xy`.

    Two hands of a first manipulation never fall on different sides of m (unless 16 draws failed).
    """
    key_first, key_later = jax.random.split(key)
    first = _first_manipulations(strains, candidates, xy, key=key_first)
    later = random_manipulations((strains, steps - 1), key=key_later)
    return jnp.concatenate([first[:, None], later], axis=1)


def _first_manipulations(
    strains: int, candidates: Candidates, xy: Float[Array, "candidates 2"], *, key: PRNGKeyArray
) -> Float[Array, "strains 6"]:
    key_hands, key_grasps, key_displacement = jax.random.split(key, 3)
    single = (jax.random.uniform(key_hands, (strains, 1)) < SINGLE_SHARE) | (candidates.present < 2)
    chance = jax.random.uniform(key_grasps, (2, strains, FIRST_STEP_DRAWS))
    one = jnp.floor(chance[0] * candidates.present).astype(jnp.int32)
    other = jnp.floor(chance[1] * (candidates.present - 1)).astype(jnp.int32)
    other = jnp.where(single, one, other + (other >= one))
    displacement = jax.random.uniform(key_displacement, (strains, FIRST_STEP_DRAWS, 2), minval=-REACH, maxval=REACH)

    grasps = jnp.asarray(candidates.grasps)
    valid = release_points(jnp.stack([xy[one], xy[other]], axis=-2), displacement).same_side
    drawn = jnp.concatenate([grasps[one], grasps[other], displacement], axis=-1)
    return _first_valid(drawn, jnp.asarray(valid))


def _first_valid(drawn: Float[Array, "strains draws 6"], valid: Bool[Array, "strains draws"]) -> Array:
    chosen = jnp.argmax(valid, axis=-1)
    return jnp.take_along_axis(drawn, chosen[:, None, None], axis=1)[:, 0]


def snap(
    manipulation: Float[Array, "6"],
    wanted: Float[Array, "2 2"],
    candidates: Candidates,
    xy: Float[Array, "candidates 2"],
) -> Float[Array, "6"]:
    """The manipulation with each grasp point moved to the nearest candidate in xy (design 6.11).

    Its grasp points lie at `wanted`, the candidates at `xy`.
    """
    squared = jnp.sum((wanted[:, None] - xy) ** 2, axis=-1)
    nearest = jnp.argmin(jnp.where(jnp.arange(len(xy)) < candidates.present, squared, jnp.inf), axis=-1)
    return jnp.concatenate([jnp.asarray(candidates.grasps)[nearest].reshape(4), manipulation[4:]])
