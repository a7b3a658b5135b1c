"""The topology of a cloth: its flat shape as a grid of vertices, its springs and its symmetries (4.2.1, 4.6, eq. 11).

A topology is data: functions that depend on the cloth's shape take one, and `SQUARE`, the paper's cloth, is the
default. `square` and `rectangle` make others; any other grid is a `Topology` with its own numbers.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped

CLOTH_LENGTH = 1.4
"""Length of the longer side of a flat cloth [normalised]: the unit (cloth length) of reported mesh errors.

It is the longer side, and not the root of the area, so that a flat cloth of any aspect ratio fits into the viewport in
any orientation, and so that errors of cloths of all ratios are in one unit.
"""

PAPERS_CLOTH = np.array([CLOTH_LENGTH, CLOTH_LENGTH, 0.007], np.float32)
"""What a ruler tells of the paper's cloth [normalised]: its sides along u and along v, and its thickness, the distance
of touching layers. It is a square of 0.4 m, 2 mm thick."""

SWAP, REVERSE_U, REVERSE_V = 1, 2, 4
"""Bits of a symmetry, which are applied to the labels in this order: swap the axes u and v, reverse u, reverse v."""

SPRING_OFFSETS = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2))
"""Grid offsets of eq. (11)'s springs: two stretch, two shear, two bend."""

Shape = tuple[int, int]
"""Numbers of vertices along u and along v."""


class Springs(NamedTuple):
    """Springs of eq. (11): vertex indices of their ends, and rest lengths [normalised]."""

    ends: Int[np.ndarray, "springs 2"]
    rest: Float[np.ndarray, " springs"]


class SpringOffset(NamedTuple):
    """All springs of one kind: the grid offset between their ends, and their rest length [normalised]."""

    du: int
    dv: int
    rest: float


@dataclass(frozen=True)
class Topology:
    """A rectangular grid of vertices in a flat shape, with the symmetries of that shape. It is hashable.

    A symmetry is a relabelling of the grid that maps the flat shape onto itself, written as a sum of the bits SWAP,
    REVERSE_U and REVERSE_V. The symmetries are a group whose first element is the identity, 0. A relabelling's index
    `k` is its place in `symmetries`. Raises ValueError if the parts do not fit together.
    """

    shape: Shape
    sides: tuple[float, float]
    """Side lengths of the flat cloth along u and along v [normalised]; the longer one is CLOTH_LENGTH."""
    symmetries: tuple[int, ...] = (0,)

    def __post_init__(self) -> None:
        if min(self.shape) < 2:
            raise ValueError(f"topology with {_by(self.shape)} vertices, expected at least 2 along each side")
        if not (min(self.sides) > 0 and abs(max(self.sides) - CLOTH_LENGTH) < 1e-9):
            raise ValueError(f"topology with sides {_by(self.sides)}, expected the longer to be {CLOTH_LENGTH:g}")
        known = set(self.symmetries)
        if not known <= set(range(8)) or len(known) < len(self.symmetries) or self.symmetries[:1] != (0,):
            raise ValueError(
                f"topology with symmetries {self.symmetries}, expected different ones of 0 to 7, the identity 0 first"
            )
        if self.swaps and (self.shape[0] != self.shape[1] or self.sides[0] != self.sides[1]):
            raise ValueError(
                f"topology with {_by(self.shape)} vertices and sides {_by(self.sides)}: swapping the axes does not map "
                "it onto itself"
            )
        if any(_compose(first, second) not in known for first in known for second in known):
            raise ValueError(f"topology with symmetries {self.symmetries}, which are no group")

    @property
    def count(self) -> int:
        """The number of symmetries."""
        return len(self.symmetries)

    @property
    def swaps(self) -> bool:
        """Whether a symmetry swaps the axes u and v."""
        return any(symmetry & SWAP for symmetry in self.symmetries)

    @property
    def composed(self) -> Int[np.ndarray, "count count"]:
        """[i, j] is the index of the relabelling by symmetry i followed by that by symmetry j."""
        return _composed(self.symmetries).copy()

    @property
    def inverses(self) -> Int[np.ndarray, " count"]:
        """The index of the inverse of each symmetry."""
        return np.argmin(_composed(self.symmetries), axis=1).astype(np.int32)

    @property
    def spacing(self) -> tuple[float, float]:
        """Distance of neighbouring vertices along u and along v [normalised]."""
        (rows, columns), (along_u, along_v) = self.shape, self.sides
        return along_u / (rows - 1), along_v / (columns - 1)

    @property
    def spring_offsets(self) -> tuple[SpringOffset, ...]:
        """Eq. (11)'s springs by kind, with the rest lengths of the flat cloth."""
        along_u, along_v = self.spacing
        # The ratio is exactly 1 for a square, whose rest lengths are multiples of its one spacing.
        ratio = along_v / along_u
        return tuple(SpringOffset(du, dv, float(np.hypot(du, dv * ratio)) * along_u) for du, dv in SPRING_OFFSETS)

    def geodesic(self) -> Float[np.ndarray, "u v 2"]:
        """The geodesic coordinates (u, v) of each vertex, -1..1."""
        return geodesic(self.shape)

    def flat(self) -> Float[np.ndarray, "u v 3"]:
        """The flat, axis-aligned cloth on the table, centred: u along x, v along y [normalised]."""
        uv = self.geodesic() * (np.array(self.sides) / 2).astype(np.float32)
        return np.concatenate([uv, np.zeros((*self.shape, 1), np.float32)], axis=-1)

    def triangles(self) -> Int[np.ndarray, "triangles 3"]:
        """Vertex indices of the triangles; see `triangles`."""
        return triangles(self.shape)

    def edges(self) -> Int[np.ndarray, "edges 2"]:
        """Vertex indices of all edges of the triangles; see `edges`."""
        return edges(self.shape)

    def springs(self) -> Springs:
        """Stretch, shear and bend springs between near vertices; rest lengths are those of the flat cloth."""
        index = _numbered(self.shape)
        rows, columns = self.shape
        ends, rests = [], []
        for du, dv, rest in self.spring_offsets:
            low, high = max(0, -dv), columns - max(0, dv)
            pair = np.stack([index[: rows - du, low:high], index[du:, low + dv : high + dv]], -1).reshape(-1, 2)
            ends.append(pair)
            rests.append(np.full(len(pair), rest, np.float32))
        return Springs(np.concatenate(ends), np.concatenate(rests))


def square(vertices: int = 32) -> Topology:
    """A square cloth with `vertices` vertices along each side, and its eight symmetries in order of their bits."""
    return Topology((vertices, vertices), (CLOTH_LENGTH, CLOTH_LENGTH), tuple(range(8)))


def rectangle(ratio: float, *, shape: Shape = (32, 32)) -> Topology:
    """A rectangular cloth whose side along u is `ratio` times that along v, with its four symmetries.

    The grid has `shape` vertices, so that its spacings along u and v differ. A ratio of 1 is a rectangle with four
    symmetries, too: a square's eight come from `square`. Raises ValueError if the ratio is not above 0.
    """
    if not (np.isfinite(ratio) and ratio > 0):
        raise ValueError(f"rectangle of ratio {ratio:g}, expected a number above 0")
    sides = (CLOTH_LENGTH, CLOTH_LENGTH / ratio) if ratio >= 1 else (CLOTH_LENGTH * ratio, CLOTH_LENGTH)
    return Topology(shape, sides, (0, REVERSE_U, REVERSE_V, REVERSE_U | REVERSE_V))


def geodesic(shape: Shape) -> Float[np.ndarray, "u v 2"]:
    """The geodesic coordinates (u, v) of each vertex of a grid, -1..1."""
    u, v = (np.linspace(-1, 1, count, dtype=np.float32) for count in shape)
    return np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1)


def triangles(shape: Shape) -> Int[np.ndarray, "triangles 3"]:
    """Vertex indices (row by row) of two triangles per quad, which share the diagonal (u, v)-(u + 1, v + 1).

    On the flat cloth, seen from above, all triangles are counter-clockwise.
    """
    (rows, columns), index = shape, _numbered(shape)
    p00, p01, p10, p11 = (index[a : rows - 1 + a, b : columns - 1 + b].ravel() for a, b in np.ndindex(2, 2))
    return np.stack([np.stack([p00, p10, p11], -1), np.stack([p00, p11, p01], -1)], axis=1).reshape(-1, 3)


def edges(shape: Shape) -> Int[np.ndarray, "edges 2"]:
    """Vertex indices of all edges of a grid's triangles: along u, along v and the diagonals."""
    index = _numbered(shape)
    along = [(index[:-1], index[1:]), (index[:, :-1], index[:, 1:]), (index[:-1, :-1], index[1:, 1:])]
    return np.concatenate([np.stack([a.ravel(), b.ravel()], -1) for a, b in along])


def thinned(values: Shaped[Any, "*batch u v c"], stride: int) -> Shaped[Any, "*batch thin_u thin_v c"]:
    """Every `stride`-th vertex along u and along v of an array over all vertices of a grid.

    The kept vertices lie symmetrically, so that they are the same under all symmetries.
    """
    if stride == 1:
        return values
    rows, columns = (_kept(count, stride) for count in values.shape[-3:-1])
    return values[..., rows[:, None], columns, :]


def _kept(count: int, stride: int) -> Int[np.ndarray, " kept"]:
    half = np.arange((stride - 1) // 2, count // 2, stride)
    return np.concatenate([half, (count - 1 - half)[::-1]])


def _numbered(shape: Shape) -> Int[np.ndarray, "u v"]:
    """The index of each vertex, row by row: u * (number along v) + v."""
    return np.arange(shape[0] * shape[1], dtype=np.int32).reshape(shape)


def _compose(first: int, second: int) -> int:
    """The bits of the relabelling by `first` followed by that by `second`."""
    swap, reversals = first & SWAP, first & (REVERSE_U | REVERSE_V)
    if second & SWAP:
        reversals = (REVERSE_V if first & REVERSE_U else 0) | (REVERSE_U if first & REVERSE_V else 0)
    return (swap ^ (second & SWAP)) | (reversals ^ (second & (REVERSE_U | REVERSE_V)))


@cache
def _composed(symmetries: tuple[int, ...]) -> Int[np.ndarray, "count count"]:
    place = {symmetry: k for k, symmetry in enumerate(symmetries)}
    return np.array([[place[_compose(a, b)] for b in symmetries] for a in symmetries], np.int32)


def _by(numbers: tuple[int, int] | tuple[float, float]) -> str:
    return f"{numbers[0]:g} x {numbers[1]:g}"


SQUARE = square()
"""The paper's cloth: 32 x 32 vertices, -0.7..0.7 in x and y when flat, eight symmetries."""
