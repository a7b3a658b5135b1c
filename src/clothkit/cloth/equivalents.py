"""The square's symmetries under their former names, for modules that do not take a topology yet."""

from clothkit.cloth.symmetry import (
    equivalents,
    equivalents_of_manipulation,
    relabel,
    relabel_batch,
    relabel_manipulation,
    relabel_manipulation_batch,
)
from clothkit.cloth.topology import REVERSE_U, REVERSE_V, SQUARE, SWAP

__all__ = [
    "COUNT",
    "INVERSE",
    "REVERSE_U",
    "REVERSE_V",
    "SWAP",
    "compose",
    "equivalents",
    "equivalents_of_manipulation",
    "inverse",
    "relabel",
    "relabel_batch",
    "relabel_manipulation",
    "relabel_manipulation_batch",
]

COUNT = SQUARE.count
INVERSE = SQUARE.inverses


def compose(first: int, second: int) -> int:
    """`Topology.composed` of the square."""
    return int(SQUARE.composed[first, second])


def inverse(k: int) -> int:
    """`Topology.inverses` of the square."""
    return int(INVERSE[k])
