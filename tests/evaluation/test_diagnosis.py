"""Losses of recorded manipulations: those of the planner's objective, whatever measures doubt."""

from dataclasses import replace

import numpy as np
import pytest

from clothkit.dataset.tasks import Task
from clothkit.episodes.record import tasks_of_dataset
from clothkit.evaluation.diagnosis import planning_losses
from clothkit.planning.conditional import Conditional
from clothkit.planning.objective import Distance
from clothkit.planning.planner import Planner
from tests import toy_dataset
from tests.planning import toy

LENGTH = 2


def losses(planner: Planner, farther: float = 1.0) -> np.ndarray:
    """Of the recorded plans, whose first displacement is so many times as long."""
    tasks = tasks_of_dataset(toy_dataset.dataset(3), [Task(sequence, 0, LENGTH) for sequence in range(3)], "test")
    assert tasks.recorded is not None
    plans = np.stack([stretch[1] for stretch in tasks.recorded]).astype(np.float32)
    plans[:, 0, 4:] *= np.float32(farther)
    candidates = np.full((3, toy.CANDIDATES.most, 2), np.nan, np.float32)
    for row, state in enumerate(tasks.start):
        found = planner.representation.candidates(state, toy.CANDIDATES)
        candidates[row, : len(found)] = found
    goals = planner.representation.of_meshes(tasks.goal)
    return planning_losses(planner, tasks.start, goals, plans, tasks.cloths.cloth, candidates)


def test_terms_that_are_posed_with_plans_are_posed() -> None:
    """They ask for plans on the support of each state."""
    usual = replace(toy.planner("b1"), accuracy=Distance(), terms={})
    zero, one = (
        replace(usual, terms={"uncertainty": Conditional(np.float32(weight), np.float32(0.0), draws=8)})
        for weight in (0, 1)
    )
    doubted = losses(one) - losses(zero)
    assert np.isfinite(doubted).all()
    assert (doubted > 0).all()


@pytest.mark.parametrize("name", ["b1", "b2"])
def test_recorded_plans_reach_their_goals(name: str) -> None:
    planner = replace(toy.planner(name), accuracy=Distance())
    assert (losses(planner) < losses(planner, 0.7)).all()
