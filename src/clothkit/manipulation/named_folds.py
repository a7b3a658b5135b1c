"""Named goals as data: which points of a flat cloth come to lie where, fold by fold.

A fold is one manipulation: its hands are mirrored across one line (eq. 1), and with them all cloth on their side of it.
So corners that go in from four sides need four folds.

Sources of GOALS:

[1] X. Lin, Y. Wang, J. Olkin, D. Held, "SoftGym: Benchmarking Deep Reinforcement Learning for Deformable Object
    Manipulation", CoRL 2020: FoldCloth, and the same from a crumpled cloth.
[2] K. Mo, C. Xia, X. Wang, Y. Deng, X. Gao, B. Liang, "Foldsformer: Learning Sequential Multi-Step Cloth Manipulation
    with Space-Time Attention", IEEE RA-L 8(2), 2023: double straight, double triangle, all corners inward and
    corners-edges inward, by one hand, which moves corners and edges by 0.9 of their way inward.
[3] T. Weng, S. Bajracharya, Y. Wang, K. Agrawal, D. Held, "FabricFlowNet: Bimanual Cloth Manipulation with a Flow-based
    Policy", CoRL 2021: triangle, two sides, opposite corners in, all corners in.
[4] S. Chen, Y. Xu, C. Yu, L. Li, X. Ma, Z. Xu, D. Hsu, "DaXBench: Benchmarking Deformable Object Manipulation with
    Differentiable Physics", ICLR 2023: Fold-Cloth-1 and Fold-Cloth-3, a rectangle in one fold and in three.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from clothkit.cloth.topology import SQUARE, Topology

INWARD = 0.9
"""Share of their way by which edges and corners go in, as in [2], so that they do not come to lie on one another."""

ON_LINE = 1e-6
"""Distance from a fold line up to which a point stays where it is [normalised]."""

Place = tuple[float, float]
"""A place u, v in the plane in which the flat cloth lay: its geodesic coordinates, beyond -1..1 if beside the cloth."""


Grasps = tuple[Place, ...]
"""The point of the cloth that each hand grasps, with all layers below it; geodesic."""


class Fold(NamedTuple):
    """One manipulation: all cloth on the hands' side of a line is mirrored across it."""

    grasps: Grasps
    point: Place
    """A point of the cloth on the hands' side; geodesic. The line is half way between its place and its image."""
    image: Place
    """Where that point comes to lie."""
    others: tuple[Grasps, ...] = ()
    """Other grasps for the same fold, for cloths that crease or curl with the first ones."""


Folds = tuple[Fold, ...]


@dataclass(frozen=True)
class Goal:
    """A shape of folded cloth that has a name."""

    name: str
    summary: str
    """What it is, in a few words."""
    source: str
    """Whose task it is, in which of the sources [1] to [4]; empty: nobody's."""
    folds: Callable[[Topology], Folds]
    """The folds that make it of a flat cloth."""

    @property
    def manipulations(self) -> int:
        """How many manipulations it needs from the flat cloth, by hands that grasp all layers."""
        return len(self.folds(SQUARE))


class Layout(NamedTuple):
    """Points of a cloth that was folded exactly, as if it had no thickness."""

    xy: Float[np.ndarray, "*points 2"]
    """Where they lie [normalised]; the flat cloth's middle was at (0, 0)."""
    moved: Bool[np.ndarray, "*points"]
    """Whether any fold moved them."""


def plane(topology: Topology, places: Float[np.ndarray, "*points 2"]) -> Float[np.ndarray, "*points 2"]:
    """The places [*points 2] in normalised units."""
    return places.astype(float) * (np.array(topology.sides) / 2)


def layout(topology: Topology, folds: Folds, points: Float[np.ndarray, "*points 2"] | None = None) -> Layout:
    """Where points of the cloth (geodesic; default: all its vertices) lie after exact folds."""
    xy = plane(topology, topology.geodesic() if points is None else points)
    moved = np.zeros(xy.shape[:-1], bool)
    for number in range(len(folds)):
        start, way = way_of(topology, folds[: number + 1])
        across = (xy - start - way / 2) @ way / (way @ way)
        over = across < -ON_LINE
        xy, moved = np.where(over[..., None], xy - 2 * across[..., None] * way, xy), moved | over
    return Layout(xy, moved)


def way_of(topology: Topology, folds: Folds) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Where the point of the last of the folds lies before it, and by how much the fold moves it [normalised]."""
    start = layout(topology, folds[:-1], np.array(folds[-1].point, float)).xy
    return start, plane(topology, np.array(folds[-1].image, float)) - start


def manipulations(topology: Topology, folds: Folds) -> Float[np.ndarray, "folds 6"]:
    """The folds as manipulations of a cloth that lies flat at first, u along x, as if what is let go did not slide."""
    return np.array(
        [
            [*fold.grasps[0], *fold.grasps[-1], *way_of(topology, folds[: number + 1])[1]]
            for number, fold in enumerate(folds)
        ]
    )


def turned(
    manipulation: Float[np.ndarray, "*batch 6"], *, quarters: int, mirrored: bool
) -> Float[np.ndarray, "*batch 6"]:
    """Manipulations of a cloth that lies flat at first, done from another of its sides.

    They are mirrored, so that what was done at v is done at -v, and then turned by quarters, counter-clockwise. After
    an odd number of quarters, the cloth is one with the sides exchanged.
    """
    pairs = manipulation.reshape(*manipulation.shape[:-1], 3, 2)
    across, along = pairs[..., 0], pairs[..., 1] * (-1 if mirrored else 1)
    for _ in range(quarters):
        across, along = -along, across
    return np.stack([across, along], axis=-1).reshape(manipulation.shape)


def _half(topology: Topology) -> Folds:
    return (Fold(((-1.0, -1.0), (-1.0, 1.0)), point=(-1.0, 0.0), image=(1.0, 0.0)),)


def _quarter(topology: Topology) -> Folds:
    # Hands that grasped the crease would hold but one of the two layers.
    return (*_half(topology), Fold(((0.2, -1.0), (0.8, -1.0)), point=(0.5, -1.0), image=(0.5, 1.0)))


def _thirds(topology: Topology) -> Folds:
    third = 1 / 3
    return (
        Fold(((1.0, -1.0), (1.0, 1.0)), point=(1.0, 0.0), image=(-third, 0.0)),
        Fold(((-1.0, -1.0), (-1.0, 1.0)), point=(-1.0, 0.0), image=(third, 0.0)),
    )


def _eighth(topology: Topology) -> Folds:
    return (
        *_half(topology),
        Fold(((0.0, -1.0), (0.0, 1.0)), point=(0.0, 0.0), image=(1.0, 0.0)),
        Fold(((0.6, -1.0), (0.9, -1.0)), point=(0.75, -1.0), image=(0.75, 1.0)),
    )


def _edges_in(topology: Topology) -> Folds:
    return _edge_in(-1.0), _edge_in(1.0)


def _edge_in(end: float) -> Fold:
    return Fold(((end, -1.0), (end, 1.0)), point=(end, 0.0), image=(end * (1.0 - INWARD), 0.0))


def _corner_in(topology: Topology, u: float, v: float) -> Fold:
    """A corner goes in half way between its edges: to the middle of a square, to the middle line of a rectangle."""
    along_u, along_v = topology.sides
    inward = INWARD * min(topology.sides)
    return Fold(((u, v),), point=(u, v), image=(u * (1.0 - inward / along_u), v * (1.0 - inward / along_v)))


def _one_corner_in(topology: Topology) -> Folds:
    return (_corner_in(topology, -1.0, -1.0),)


def _opposite_corners_in(topology: Topology) -> Folds:
    return _corner_in(topology, -1.0, -1.0), _corner_in(topology, 1.0, 1.0)


_CORNERS = ((-1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (1.0, -1.0))


def _corners_in(topology: Topology) -> Folds:
    return tuple(_corner_in(topology, u, v) for u, v in _CORNERS)


def _corners_and_edges_in(topology: Topology) -> Folds:
    return _corner_in(topology, -1.0, -1.0), _corner_in(topology, -1.0, 1.0), _edge_in(1.0)


def _triangle(topology: Topology) -> Folds:
    """A rectangle's diagonal is no line of symmetry: its corner comes to lie beside the cloth."""
    along_u, along_v = topology.sides
    # Twice the way from the corner to the diagonal, as a share of the way to the opposite corner for a square.
    share = 4 * along_u * along_v / (along_u**2 + along_v**2)
    image = (-1.0 + share * along_v / along_u, -1.0 + share * along_u / along_v)
    # By its corner alone, rough cloth is dragged into creases; held beside it, the corner of limp cloth curls.
    beside = [way * min(topology.sides) for way in (1 / 8, 1 / 4, 3 / 8)]
    others = tuple(((-1.0 + way / along_u, -1.0), (-1.0, -1.0 + way / along_v)) for way in beside)
    return (Fold(((-1.0, -1.0),), point=(-1.0, -1.0), image=image, others=others),)


def _double_triangle(topology: Topology) -> Folds:
    """One end of the diagonal onto the other. Of a rectangle's pentagon, a second corner goes with it."""
    along_u, along_v = topology.sides
    corner: Grasps = ()
    if along_u != along_v:
        corner = ((-1.0, -1.0) if along_u > along_v else (1.0, 1.0),)
    # At the very end of the diagonal a hand would hold but one of the two layers.
    first, *others = (((along, 1.0), *corner) for along in (-0.8, -0.85, -0.9))
    return (*_triangle(topology), Fold(first, point=(-1.0, 1.0), image=(1.0, -1.0), others=tuple(others)))


GOALS = {
    goal.name: goal
    for goal in (
        Goal("half", "one edge onto the opposite one", "SoftGym FoldCloth [1], DaXBench Fold-Cloth-1 [4]", _half),
        Goal("triangle", "along a diagonal", "FabricFlowNet triangle [3]", _triangle),
        Goal("thirds", "both edges over the middle third, as a letter", "", _thirds),
        Goal("quarter", "half, and half again the other way", "Foldsformer double straight [2]", _quarter),
        Goal("double-triangle", "a triangle, and its half", "Foldsformer double triangle [2]", _double_triangle),
        Goal("edges-in", "two opposite edges to the middle line", "FabricFlowNet two sides [3]", _edges_in),
        Goal("one-corner-in", "one corner to the middle", "", _one_corner_in),
        Goal(
            "opposite-corners-in",
            "two opposite corners to the middle",
            "FabricFlowNet opposite corners in [3]",
            _opposite_corners_in,
        ),
        Goal("corners-in", "all four corners to the middle", "Foldsformer all corners inward [2]", _corners_in),
        Goal(
            "corners-and-edges-in",
            "two corners and the edge opposite them to the middle",
            "Foldsformer corners-edges inward [2]",
            _corners_and_edges_in,
        ),
        Goal(
            "eighth",
            "half, half again the same way, and half the other way",
            "three folds, as DaXBench Fold-Cloth-3 [4]",
            _eighth,
        ),
    )
}
"""All named goals, by name. Of a rectangle, the first fold is across its longer side."""
