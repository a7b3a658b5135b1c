"""The grid topology of all meshes: vertices, geodesic coordinates, triangles and springs (section 4.2.1, eq. 11)."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped

SIDE = 32
"""Number of vertices along one side of the cloth."""

CLOTH_SIDE = 1.4
"""Side length of the flat cloth in normalised coordinates, which is the unit (cloth length) of reported mesh errors."""


def flat(side: int = SIDE) -> Float[np.ndarray, "u v 3"]:
    """The flat, axis-aligned cloth on the table: -0.7..0.7 in x (along u) and y (along v) [normalised]."""
    uv = geodesic(side) * (CLOTH_SIDE / 2)
    return np.concatenate([uv, np.zeros((side, side, 1), np.float32)], axis=-1)


def geodesic(side: int = SIDE) -> Float[np.ndarray, "u v 2"]:
    """The geodesic coordinates (u, v) of each vertex, -1..1."""
    axis = np.linspace(-1, 1, side, dtype=np.float32)
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)


def thinned(values: Shaped[Any, "*batch u v c"], stride: int) -> Shaped[Any, "*batch thin thin c"]:
    """Every `stride`-th vertex along u and v of an array over all vertices.

    The kept vertices lie symmetrically, so that they are the same in all eight labellings.
    """
    if stride == 1:
        return values
    half = np.arange((stride - 1) // 2, SIDE // 2, stride)
    kept = np.concatenate([half, (SIDE - 1 - half)[::-1]])
    return values[..., kept[:, None], kept, :]


def triangles(side: int = SIDE) -> Int[np.ndarray, "triangles 3"]:
    """Vertex indices (u * side + v) of two triangles per quad, which share the diagonal (u, v)-(u + 1, v + 1).

    On the flat cloth, seen from above, all triangles are counter-clockwise.
    """
    index = np.arange(side * side, dtype=np.int32).reshape(side, side)
    p00, p01, p10, p11 = (index[a : side - 1 + a, b : side - 1 + b].ravel() for a, b in np.ndindex(2, 2))
    return np.stack([np.stack([p00, p10, p11], -1), np.stack([p00, p11, p01], -1)], axis=1).reshape(-1, 3)


def edges(side: int = SIDE) -> Int[np.ndarray, "edges 2"]:
    """Vertex indices of all edges of the triangles: along u, along v and the diagonals."""
    index = np.arange(side * side, dtype=np.int32).reshape(side, side)
    along = [(index[:-1], index[1:]), (index[:, :-1], index[:, 1:]), (index[:-1, :-1], index[1:, 1:])]
    return np.concatenate([np.stack([a.ravel(), b.ravel()], -1) for a, b in along])


SPRING_OFFSETS = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2))
"""Grid offsets of eq. (11)'s springs: two stretch, two shear, two bend."""


class Springs(NamedTuple):
    """Springs of eq. (11): vertex indices of their ends, and rest lengths [normalised]."""

    ends: Int[np.ndarray, "springs 2"]
    rest: Float[np.ndarray, " springs"]


def springs(side: int = SIDE) -> Springs:
    """Stretch, shear and bend springs between near grid vertices; rest lengths are those of the flat cloth."""
    index = np.arange(side * side, dtype=np.int32).reshape(side, side)
    spacing = CLOTH_SIDE / (side - 1)
    ends, rest = [], []
    for du, dv in SPRING_OFFSETS:
        low, high = max(0, -dv), side - max(0, dv)
        pair = np.stack([index[: side - du, low:high], index[du:, low + dv : high + dv]], -1).reshape(-1, 2)
        ends.append(pair)
        rest.append(np.full(len(pair), np.hypot(du, dv) * spacing, np.float32))
    return Springs(np.concatenate(ends), np.concatenate(rest))
