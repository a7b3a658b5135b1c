"""The square grid under its former names, for modules that do not take a topology yet."""

import numpy as np
from jaxtyping import Float, Int

from clothkit.cloth import topology
from clothkit.cloth.topology import CLOTH_LENGTH, SPRING_OFFSETS, SQUARE, Springs, square, thinned

__all__ = [
    "CLOTH_SIDE",
    "SIDE",
    "SPRING_OFFSETS",
    "Springs",
    "edges",
    "flat",
    "geodesic",
    "springs",
    "thinned",
    "triangles",
]

SIDE = SQUARE.shape[0]
CLOTH_SIDE = CLOTH_LENGTH


def flat(side: int = SIDE) -> Float[np.ndarray, "u v 3"]:
    """`Topology.flat` of a square."""
    return square(side).flat()


def geodesic(side: int = SIDE) -> Float[np.ndarray, "u v 2"]:
    """`topology.geodesic` of a square."""
    return topology.geodesic((side, side))


def triangles(side: int = SIDE) -> Int[np.ndarray, "triangles 3"]:
    """`topology.triangles` of a square."""
    return topology.triangles((side, side))


def edges(side: int = SIDE) -> Int[np.ndarray, "edges 2"]:
    """`topology.edges` of a square."""
    return topology.edges((side, side))


def springs(side: int = SIDE) -> Springs:
    """`Topology.springs` of a square."""
    return square(side).springs()
