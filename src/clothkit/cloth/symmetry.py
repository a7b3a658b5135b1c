"""Relabelling by a cloth's symmetries: its Cartesian equivalents describe one shape (section 4.6, figure 7).

An equivalent has an index k, the place of its symmetry in `Topology.symmetries`. The square has eight, the dihedral
group of the square; a rectangle has four. Relabelling needs a topology's symmetries alone, so arrays over a thinned
grid, or over columns of voxels, can be relabelled, too.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped
from numpy import integer, ndarray

from clothkit.cloth.topology import REVERSE_U, REVERSE_V, SQUARE, SWAP, Topology

SAME = 1e-3
"""Largest difference between the sides of a square [normalised]."""

Index = int | integer | Int[Array | ndarray, "..."]
"""The index k of an equivalent, or several to be broadcast: a number, an element of `Topology.inverses`, an array."""


def relabel(
    mesh: Shaped[Array | ndarray, "*batch u v c"],
    k: Index,
    topology: Topology = SQUARE,
) -> Shaped[Array, "*batch u v c"]:
    """The mesh, or any array over its vertices, in the labels of equivalent k; k may be a traced array."""
    symmetry = _symmetry(k, topology)
    mesh = jnp.asarray(mesh)
    if topology.swaps:
        mesh = jnp.where(symmetry & SWAP, jnp.swapaxes(mesh, -3, -2), mesh)
    mesh = jnp.where(symmetry & REVERSE_U, jnp.flip(mesh, -3), mesh)
    return jnp.where(symmetry & REVERSE_V, jnp.flip(mesh, -2), mesh)


def relabel_manipulation(
    manipulation: Float[Array | ndarray, "*batch 6"],
    k: Index,
    topology: Topology = SQUARE,
) -> Float[Array, "*batch 6"]:
    """The manipulation in the labels of equivalent k: its grasp points change, its displacement does not."""
    symmetry = _symmetry(k, topology)
    manipulation = jnp.asarray(manipulation)
    u1, v1, u2, v2, dx, dy = jnp.moveaxis(manipulation, -1, 0)
    u1, v1 = jnp.where(symmetry & SWAP, v1, u1), jnp.where(symmetry & SWAP, u1, v1)
    u2, v2 = jnp.where(symmetry & SWAP, v2, u2), jnp.where(symmetry & SWAP, u2, v2)
    sign_u = jnp.where(symmetry & REVERSE_U, -1, 1)
    sign_v = jnp.where(symmetry & REVERSE_V, -1, 1)
    return jnp.stack([u1 * sign_u, v1 * sign_v, u2 * sign_u, v2 * sign_v, dx, dy], axis=-1)


def equivalents(
    mesh: Shaped[Array | ndarray, "*batch u v c"], topology: Topology = SQUARE
) -> Shaped[Array, "count *batch u v c"]:
    """All equivalents of a mesh, in order of k."""
    plain = jnp.asarray(mesh)
    swapped = jnp.swapaxes(plain, -3, -2) if topology.swaps else plain
    reversed_axes = ((REVERSE_U, -3), (REVERSE_V, -2))
    return jnp.stack(
        [
            jnp.flip(swapped if symmetry & SWAP else plain, [axis for bit, axis in reversed_axes if symmetry & bit])
            for symmetry in topology.symmetries
        ]
    )


def equivalents_of_manipulation(
    manipulation: Float[Array | ndarray, "*batch 6"], topology: Topology = SQUARE
) -> Float[Array, "count *batch 6"]:
    """A manipulation in the labels of each of the equivalents, in order of k."""
    return jnp.stack([relabel_manipulation(manipulation, k, topology) for k in range(topology.count)])


def relabel_batch(
    mesh: Shaped[Array | ndarray, "batch *steps u v c"],
    k: Int[Array | ndarray, " batch"],
    topology: Topology = SQUARE,
) -> Shaped[Array, "batch *steps u v c"]:
    """A batch of meshes (or of sequences of meshes), each in the labels of its own k."""
    k = jnp.asarray(k)
    return relabel(mesh, k.reshape(k.shape + (1,) * (mesh.ndim - 1)), topology)


def relabel_manipulation_batch(
    manipulation: Float[Array | ndarray, "batch *steps 6"],
    k: Int[Array | ndarray, " batch"],
    topology: Topology = SQUARE,
) -> Float[Array, "batch *steps 6"]:
    """A batch of manipulations (or of sequences of manipulations), each in the labels of its own k."""
    k = jnp.asarray(k)
    return relabel_manipulation(manipulation, k.reshape(k.shape + (1,) * (manipulation.ndim - 2)), topology)


def relabel_cloth(cloth: Float[Array | ndarray, "... 3"], k: Index) -> Float[Array, "... 3"]:
    """A cloth's sides and thickness in the labels of the square's equivalent k, which may swap the sides."""
    cloth = jnp.asarray(cloth)
    swapped = jnp.asarray(k)[..., None] & SWAP > 0
    return jnp.where(swapped, cloth[..., jnp.array([1, 0, 2])], cloth)


def equivalent_cloths(cloth: Float[Array | ndarray, "*batch 3"]) -> Float[Array, "8 *batch 3"]:
    """A cloth's sides and thickness in the labels of each of the square's equivalents, in order of k."""
    return jnp.stack([relabel_cloth(cloth, k) for k in range(SQUARE.count)])


def equal_labellings(cloth: Float[Array | ndarray, "*batch 3"]) -> Bool[Array, "*batch 8"]:
    """Which of the square's equivalents leave a cloth's sides as they are: all for a square, half for a rectangle."""
    cloth = jnp.asarray(cloth)
    square = jnp.abs(cloth[..., 0] - cloth[..., 1]) <= SAME
    return square[..., None] | (jnp.arange(SQUARE.count) & SWAP == 0)


def among_equal_labellings(
    unlike: Float[Array, "8 ..."], cloth: Float[Array | ndarray, "*batch 3"]
) -> Float[Array, "8 ..."]:
    """How unlike something is under the labels of each of the square's equivalents, infinitely where sides differ.

    The cloths' batch axes are the last ones of `unlike`.
    """
    same = jnp.moveaxis(equal_labellings(cloth), -1, 0)
    axes_before = (1,) * (unlike.ndim - same.ndim)
    return jnp.where(same.reshape(SQUARE.count, *axes_before, *same.shape[1:]), unlike, jnp.inf)


def _symmetry(k: Index, topology: Topology) -> Int[Array, "..."]:
    """The bits of symmetry k."""
    k = jnp.asarray(k)
    in_order = topology.symmetries == tuple(range(topology.count))
    return k if in_order else jnp.asarray(topology.symmetries)[k]
