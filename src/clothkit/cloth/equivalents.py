"""The eight Cartesian equivalents: relabellings of the grid that describe one shape (section 4.6, figure 7).

An equivalent has an index k in 0..7. Its bits are applied to the labels in this order: 1 swaps the axes u and v, then 2
reverses u, then 4 reverses v. The eight relabellings are the dihedral group of the square.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped
from numpy import ndarray

COUNT = 8
SWAP, REVERSE_U, REVERSE_V = 1, 2, 4


def compose(first: int, second: int) -> int:
    """The index of the relabelling by `first` followed by that by `second`."""
    swap, reversals = first & SWAP, first & (REVERSE_U | REVERSE_V)
    if second & SWAP:
        reversals = (REVERSE_V if first & REVERSE_U else 0) | (REVERSE_U if first & REVERSE_V else 0)
    return (swap ^ (second & SWAP)) | (reversals ^ (second & (REVERSE_U | REVERSE_V)))


def inverse(k: int) -> int:
    """The index of the inverse relabelling."""
    return next(j for j in range(COUNT) if compose(k, j) == 0)


INVERSE = np.array([inverse(k) for k in range(COUNT)], np.int32)
"""The index of the inverse relabelling of each k."""


def relabel(
    mesh: Shaped[Array | ndarray, "*batch u v c"], k: int | Int[Array | ndarray, "..."]
) -> Shaped[Array, "*batch u v c"]:
    """The mesh, or any array over its vertices, in the labels of equivalent k; k may be a traced array."""
    k = jnp.asarray(k)
    mesh = jnp.asarray(mesh)
    mesh = jnp.where(k & SWAP, jnp.swapaxes(mesh, -3, -2), mesh)
    mesh = jnp.where(k & REVERSE_U, jnp.flip(mesh, -3), mesh)
    return jnp.where(k & REVERSE_V, jnp.flip(mesh, -2), mesh)


def relabel_manipulation(
    manipulation: Float[Array | ndarray, "*batch 6"], k: int | Int[Array | ndarray, "..."]
) -> Float[Array, "*batch 6"]:
    """The manipulation in the labels of equivalent k: its grasp points change, its displacement does not."""
    k = jnp.asarray(k)
    manipulation = jnp.asarray(manipulation)
    u1, v1, u2, v2, dx, dy = jnp.moveaxis(manipulation, -1, 0)
    u1, v1 = jnp.where(k & SWAP, v1, u1), jnp.where(k & SWAP, u1, v1)
    u2, v2 = jnp.where(k & SWAP, v2, u2), jnp.where(k & SWAP, u2, v2)
    sign_u = jnp.where(k & REVERSE_U, -1, 1)
    sign_v = jnp.where(k & REVERSE_V, -1, 1)
    return jnp.stack([u1 * sign_u, v1 * sign_v, u2 * sign_u, v2 * sign_v, dx, dy], axis=-1)


def equivalents(mesh: Shaped[Array | ndarray, "*batch u v c"]) -> Shaped[Array, "8 *batch u v c"]:
    """All eight equivalents of a mesh, in order of k."""
    plain = jnp.asarray(mesh)
    swapped = jnp.swapaxes(plain, -3, -2)
    reversals = [(), (-3,), (-2,), (-3, -2)]
    return jnp.stack([jnp.flip(m, axes) for axes in reversals for m in (plain, swapped)])


def equivalents_of_manipulation(manipulation: Float[Array | ndarray, "*batch 6"]) -> Float[Array, "8 *batch 6"]:
    """A manipulation in the labels of each of the eight equivalents, in order of k."""
    return jnp.stack([relabel_manipulation(manipulation, k) for k in range(COUNT)])


def relabel_batch(
    mesh: Shaped[Array | ndarray, "batch *steps u v c"], k: Int[Array | ndarray, " batch"]
) -> Shaped[Array, "batch *steps u v c"]:
    """A batch of meshes (or of sequences of meshes), each in the labels of its own k."""
    k = jnp.asarray(k)
    return relabel(mesh, k.reshape(k.shape + (1,) * (mesh.ndim - 1)))


def relabel_manipulation_batch(
    manipulation: Float[Array | ndarray, "batch *steps 6"], k: Int[Array | ndarray, " batch"]
) -> Float[Array, "batch *steps 6"]:
    """A batch of manipulations (or of sequences of manipulations), each in the labels of its own k."""
    k = jnp.asarray(k)
    return relabel_manipulation(manipulation, k.reshape(k.shape + (1,) * (manipulation.ndim - 2)))
