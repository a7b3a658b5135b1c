"""Tasks: from state `start` of a sequence, reach its state start + length in `length` manipulations (design 2)."""

from typing import NamedTuple


class Task(NamedTuple):
    """One task of one sequence."""

    sequence: int
    start: int
    length: int


TASKS = ((0, 1), (1, 1), (2, 1), (0, 2), (1, 2), (0, 3))
"""(start, length) of the six tasks of a sequence of three manipulations."""


def tasks_of(sequence: int, manipulations: int) -> list[Task]:
    """The tasks of a sequence that has this number of manipulations."""
    return [Task(sequence, start, length) for start, length in TASKS if start + length <= manipulations]
