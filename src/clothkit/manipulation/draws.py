"""Random manipulations without the restrictions of data generation (design 6.9), by JAX."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

REACH = 1.4
"""Displacements are drawn from -REACH..REACH in x and y [normalised]."""

SINGLE_SHARE = 1 / 3
"""Probability of one hand."""


@partial(jax.jit, static_argnames=("shape", "edge", "one_handed"))
def random_manipulations(
    shape: tuple[int, ...], *, edge: float = 0.0, one_handed: float = SINGLE_SHARE, key: PRNGKeyArray
) -> Float[Array, "*shape 6"]:
    """Random manipulations without the restrictions of data generation (design 6.9).

    A one-handed manipulation, of which there is a share `one_handed`, repeats its grasp point. A share `edge` of the
    geodesic grasp points is moved to the cloth's edge, and half of these to its corners.
    """
    key_grasps, key_displacement, key_hands = jax.random.split(key, 3)
    grasps = jax.random.uniform(key_grasps, (*shape, 4), minval=-1, maxval=1)
    if edge:
        grasps = _moved_to_edge(grasps, edge, key=jax.random.fold_in(key_grasps, 1))
    displacement = jax.random.uniform(key_displacement, (*shape, 2), minval=-REACH, maxval=REACH)
    single = jax.random.uniform(key_hands, shape) < one_handed
    second = jnp.where(single[..., None], grasps[..., :2], grasps[..., 2:])
    return jnp.concatenate([grasps[..., :2], second, displacement], axis=-1)


def _moved_to_edge(grasps: Float[Array, "*shape 4"], share: float, *, key: PRNGKeyArray) -> Float[Array, "*shape 4"]:
    points = grasps.reshape(*grasps.shape[:-1], 2, 2)
    key_kind, key_axis = jax.random.split(key)
    kind = jax.random.uniform(key_kind, points.shape[:-1])
    along_u = jax.random.bernoulli(key_axis, shape=points.shape[:-1])
    corner, on_edge = jnp.sign(points), jnp.stack([along_u, ~along_u], axis=-1)
    moved = jnp.where(on_edge | (kind < share / 2)[..., None], corner, points)
    return jnp.where((kind < share)[..., None], moved, points).reshape(grasps.shape)
