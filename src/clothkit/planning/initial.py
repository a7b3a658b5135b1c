"""Random plans, from which the strains of a search start (section 5.1, design 6.2 and 6.9).

Grasp points are in the net's input coordinates: geodesic, or Cartesian for the voxel baseline. `xy` are the same points
on the table [normalised], which geometric computations need.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from clothkit.manipulation.draws import REACH, SINGLE_SHARE, random_manipulations
from clothkit.manipulation.geometry import release_points
from clothkit.manipulation.sampling import SamplingConfig
from clothkit.manipulation.vector import is_null
from clothkit.planning.types import Candidates

FIRST_STEP_DRAWS = 16
"""Number of draws for a first manipulation; the first valid one is used."""

FOLD_POINT = SamplingConfig().fold_point
"""Share of the displacement at which the reference point q lies (section 4.4)."""

RASTER, EXTENT = 64, 1.1
"""Pixels per side, and half the side length [normalised], of the square mask of the area that a cloth covers."""

Covered = Bool[Array, "x y"] | Bool[np.ndarray, "x y"]


def random_plans(
    strains: int,
    steps: int,
    candidates: Candidates,
    xy: Float[Array, "candidates 2"],
    *,
    covered: Covered | None = None,
    edge: float = 0.0,
    one_handed: float = SINGLE_SHARE,
    key: PRNGKeyArray,
) -> Float[Array, "strains n 6"]:
    """Random plans whose first grasp points are drawn from the candidates, whose positions are `xy` [normalised].

    The two hands of a first manipulation lie on the same side of the line m, unless all 16 draws failed. If the mask
    `covered` is given, q of the first manipulation lies on the cloth. `edge` is the share of later grasp points on the
    cloth's edge, `one_handed` that of one-handed manipulations; with a single candidate, all first ones are.
    """
    key_first, key_later = jax.random.split(key)
    first = _first_manipulations(strains, candidates, xy, covered, one_handed, key=key_first)
    later = random_manipulations((strains, steps - 1), edge=edge, one_handed=one_handed, key=key_later)
    return jnp.concatenate([first[:, None], later], axis=1)


def _first_manipulations(
    strains: int,
    candidates: Candidates,
    xy: Float[Array, "candidates 2"],
    covered: Covered | None,
    one_handed: float,
    *,
    key: PRNGKeyArray,
) -> Float[Array, "strains 6"]:
    key_hands, key_grasps, key_displacement = jax.random.split(key, 3)
    single = (jax.random.uniform(key_hands, (strains, 1)) < one_handed) | (candidates.present < 2)
    chance = jax.random.uniform(key_grasps, (2, strains, FIRST_STEP_DRAWS))
    one = jnp.floor(chance[0] * candidates.present).astype(jnp.int32)
    other = jnp.floor(chance[1] * (candidates.present - 1)).astype(jnp.int32)
    other = jnp.where(single, one, other + (other >= one))
    places = jnp.stack([xy[one], xy[other]], axis=-2)
    if covered is None:
        displacement = jax.random.uniform(key_displacement, (strains, FIRST_STEP_DRAWS, 2), minval=-REACH, maxval=REACH)
    else:
        q = _points_on(jnp.asarray(covered), (strains, FIRST_STEP_DRAWS), key=key_displacement)
        displacement = (q - places.mean(-2)) / FOLD_POINT

    grasps = jnp.asarray(candidates.grasps)
    valid = release_points(places, displacement).same_side
    drawn = jnp.concatenate([grasps[one], grasps[other], displacement], axis=-1)
    return _first_valid(drawn, jnp.asarray(valid))


def _first_valid(drawn: Float[Array, "strains draws 6"], valid: Bool[Array, "strains draws"]) -> Array:
    chosen = jnp.argmax(valid, axis=-1)
    return jnp.take_along_axis(drawn, chosen[:, None, None], axis=1)[:, 0]


def _points_on(covered: Bool[Array, "x y"], shape: tuple[int, ...], *, key: PRNGKeyArray) -> Float[Array, "*shape 2"]:
    """Points xy [normalised] drawn uniformly from the area that the mask marks as cloth."""
    key_pixel, key_within = jax.random.split(key)
    so_far = jnp.cumsum(covered.ravel())
    pixel = jnp.searchsorted(so_far, jax.random.uniform(key_pixel, shape) * so_far[-1], side="right")
    corner = jnp.stack(jnp.divmod(pixel, covered.shape[1]), axis=-1)
    within = jax.random.uniform(key_within, (*shape, 2))
    return (corner + within) * (2 * EXTENT / covered.shape[0]) - EXTENT


def folds(
    covered: Covered, places: Float[Array, "*batch 2 2"], manipulation: Float[Array, "*batch 6"]
) -> Bool[Array, "*batch"]:
    """Whether manipulations satisfy the fold restriction of data generation (section 4.4), `[*batch]`.

    This holds if the point q lies on the cloth, or if the manipulation is null, wherever its q is. `covered` is the
    cloth's mask over the square -EXTENT..EXTENT [normalised] in x and y; `places` are the grasp points xy [normalised].
    """
    covered = jnp.asarray(covered)
    q = places.mean(-2) + FOLD_POINT * manipulation[..., 4:]
    pixel = jnp.floor((q + EXTENT) * (covered.shape[0] / (2 * EXTENT))).astype(jnp.int32)
    inside = jnp.all((pixel >= 0) & (pixel < covered.shape[0]), axis=-1)
    x, y = jnp.clip(pixel[..., 0], 0, covered.shape[0] - 1), jnp.clip(pixel[..., 1], 0, covered.shape[1] - 1)
    return (inside & covered[x, y]) | jnp.asarray(is_null(manipulation))


def snap(
    manipulation: Float[Array, "6"],
    wanted: Float[Array, "2 2"],
    candidates: Candidates,
    xy: Float[Array, "candidates 2"],
) -> Float[Array, "6"]:
    """The manipulation with each grasp point replaced by the candidate nearest in xy (design 6.11).

    `wanted` are the positions of its grasp points, `xy` those of the candidates, in one unit.
    """
    squared = jnp.sum((wanted[:, None] - xy) ** 2, axis=-1)
    nearest = jnp.argmin(jnp.where(jnp.arange(len(xy)) < candidates.present, squared, jnp.inf), axis=-1)
    return jnp.concatenate([jnp.asarray(candidates.grasps)[nearest].reshape(4), manipulation[4:]])
