"""Layers that do not pierce one another: where two parts of a cloth overlap, one lies above the other.

Each vertex of an estimated mesh is about as precise as the distance between two layers. Where the mesh lies on itself,
the layers therefore pierce one another in stripes, although it is clear which one is above when the whole overlap is
looked at: it can't change without a fold in between. So the differences in height of overlapping vertices are averaged
over neighbouring pairs, which gives an order, and the vertices are moved up and down until they keep it.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix, diags, identity
from scipy.spatial import cKDTree

APART = 2
"""Two vertices nearer to one another along the cloth than this belong to one layer [grid steps]."""

SEPARATION = 0.5
"""Distance to which two layers are moved apart, in thicknesses. Less than one, because this keeps their order as well,
and where an estimate is wrong, more layers lie on one another than in truth: the heap would be higher than was seen."""

ROUNDS = 100
"""How often differences in height are averaged over neighbouring pairs."""

RELAXATION = 1.9
"""Factor of second-order diffusion, from 1 (first order) to below 2. With it, ROUNDS reach as far as a thousand
averages without it: over all of an overlap, which then has one order. First order reaches ten grid steps, so that two
layers exchange their places halfway where an estimate is unsure."""

HIGHEST = 0.03
"""Differences in height count as at most this much [normalised], so that a steep part does not decide alone."""

MOVES = 60
"""Largest number of times that all vertices are moved."""

HIGHEST_RISE = 2.0
"""By how much a vertex is lifted at most, in thicknesses. Where an estimate is tangled, parts of it lie above one
another in a circle, and would rise without end."""

MOST_OVERLAPS = 40
"""Overlapping vertices for each vertex, in the mean over a mesh, above which a mesh is left as it is. A cloth folded
into eight layers has about 19. Above it an estimate is a heap without an order, whose pairs of pairs take gigabytes."""

TOLERANCE = 1e-4
"""Lack of distance between two layers that is left [normalised]."""


class Order(NamedTuple):
    """Pairs of overlapping vertices, the upper one first."""

    upper: Int[np.ndarray, " pairs"]
    lower: Int[np.ndarray, " pairs"]


def lift(
    mesh: Float[np.ndarray, "u v 3"], *, thickness: float, sides: tuple[float, float]
) -> Float[np.ndarray, "u v 3"]:
    """The mesh with its layers moved apart, in z alone; `sides` are those of the flat cloth [normalised].

    Two vertices overlap if they are less than the larger grid spacing apart in x and y. They are moved to a distance of
    SEPARATION x thickness if they are near one another, and to less at the border of their overlap. No vertex gets
    below half of the thickness, nor higher than HIGHEST_RISE allows. A heap is returned as it is (MOST_OVERLAPS).
    """
    reach = max(side / (count - 1) for side, count in zip(sides, mesh.shape[:2], strict=True))
    vertices = mesh.reshape(-1, 3).astype(float)
    pairs = overlapping(vertices, mesh.shape[1], reach)
    if not 0 < len(pairs) <= MOST_OVERLAPS * len(vertices):
        return mesh
    upper, lower = order_of(vertices, pairs, mesh.shape[:2])
    apart = np.linalg.norm(vertices[upper, :2] - vertices[lower, :2], axis=-1) / reach
    wanted, z = SEPARATION * thickness * np.clip(2 * (1 - apart), 0, 1), vertices[:, 2]
    highest = z + HIGHEST_RISE * thickness
    for _ in range(MOVES):
        lack = wanted - (z[upper] - z[lower])
        close = lack > TOLERANCE
        if not close.any():
            break
        up, down = np.zeros_like(z), np.zeros_like(z)
        np.maximum.at(up, upper[close], lack[close])
        np.maximum.at(down, lower[close], lack[close])
        # Lower layers give way less than upper ones, since most lie on the table.
        z += np.minimum(up / 2, highest - z) - np.minimum(down / 4, np.maximum(0, z - thickness / 2))
    return vertices.reshape(mesh.shape).astype(mesh.dtype)


def overlapping(vertices: Float[np.ndarray, "vertices 3"], columns: int, reach: float) -> Int[np.ndarray, "pairs 2"]:
    """Pairs of vertices less than `reach` apart in x and y, but not along the cloth; sorted, each in both orders."""
    pairs = cKDTree(vertices[:, :2]).query_pairs(reach, output_type="ndarray")
    u, v = np.divmod(pairs, columns)
    pairs = pairs[np.maximum(np.abs(np.diff(u)), np.abs(np.diff(v)))[:, 0] >= APART]
    both = np.concatenate([pairs, pairs[:, ::-1]])
    return both[np.lexsort((both[:, 1], both[:, 0]))]


def order_of(
    vertices: Float[np.ndarray, "vertices 3"], pairs: Int[np.ndarray, "pairs 2"], shape: tuple[int, int]
) -> Order:
    """Which vertex of each pair is the upper one, as it is in the mean over the overlap that it belongs to.

    The mean is that of second-order diffusion on the graph of neighbouring pairs (Muthukrishnan, Ghosh and Schultz
    1998).
    """
    linked = neighbours(pairs, shape) + identity(len(pairs))
    averaged = diags(1 / np.asarray(linked.sum(1)).ravel()) @ linked
    above = np.clip(vertices[pairs[:, 0], 2] - vertices[pairs[:, 1], 2], -HIGHEST, HIGHEST)
    before, above = above, averaged @ above
    for _ in range(ROUNDS - 1):
        before, above = above, RELAXATION * (averaged @ above) + (1 - RELAXATION) * before
    return Order(*pairs[above > 0].T)


def neighbours(pairs: Int[np.ndarray, "pairs 2"], shape: tuple[int, int]) -> csr_matrix:
    """A matrix with 1 for every two pairs whose first and whose second vertices are the same or next to one another."""
    rows, columns = shape
    key = pairs[:, 0] * (rows * columns) + pairs[:, 1]
    (u0, u1), (v0, v1) = (part.T for part in np.divmod(pairs, columns))
    ends: list[tuple[np.ndarray, np.ndarray]] = []
    # Half of the offsets: the matrix is symmetric.
    for a, b, c, d in (step for step in product((-1, 0, 1), repeat=4) if step > (0, 0, 0, 0)):
        inside = (u0 + a >= 0) & (u0 + a < rows) & (v0 + b >= 0) & (v0 + b < columns)
        inside &= (u1 + c >= 0) & (u1 + c < rows) & (v1 + d >= 0) & (v1 + d < columns)
        wanted = key + (a * columns + b) * (rows * columns) + c * columns + d
        place = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        found = inside & (key[place] == wanted)
        ends.append((np.flatnonzero(found), place[found]))
    first, second = (np.concatenate(parts) for parts in zip(*ends, strict=True))
    half = csr_matrix((np.ones(len(first)), (first, second)), shape=(len(pairs), len(pairs)))
    return half + half.T
