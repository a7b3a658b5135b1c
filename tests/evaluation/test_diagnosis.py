"""Losses of recorded manipulations: those of the planner's objective, whatever measures doubt."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from clothkit.dataset.tasks import Task
from clothkit.episodes.record import tasks_of_dataset
from clothkit.evaluation.diagnosis import planning_losses
from clothkit.planning import agent
from clothkit.planning.conditional import Conditional
from clothkit.planning.objective import Distance
from clothkit.planning.optimisers.random_shooting import RandomShootingConfig
from clothkit.planning.planner import Planner
from clothkit.planning.plans import pose
from clothkit.planning.search import evaluated
from clothkit.planning.types import Observation
from tests import toy_dataset
from tests.planning import toy

LENGTH = 2


def keys(seed: int = 0) -> jax.Array:
    return jax.random.split(jax.random.key(seed), 3)


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
    return planning_losses(planner, tasks.start, goals, plans, tasks.cloths.cloth, candidates, keys())


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


def test_a_plan_has_the_loss_that_its_search_found() -> None:
    """Doubt is conditional on plans that are drawn with the search's key, so that both have to draw the same ones."""
    optimiser = RandomShootingConfig(plans=8, chunk=8, finalists=2)
    usual = toy.planner("b1")
    planner = replace(
        usual,
        accuracy=Distance(),
        terms={"uncertainty": Conditional(np.float32(0.1), np.float32(0.0), draws=8)},
        settings=replace(usual.settings, search=replace(usual.settings.search, optimiser=optimiser, stride=1)),
    )
    tasks = tasks_of_dataset(toy_dataset.dataset(3), [Task(sequence, 0, LENGTH) for sequence in range(3)], "test")
    memory = agent.begin(planner, tasks.goal, np.full(3, LENGTH), tasks.cloths.cloth)
    state, candidates = agent.perceive(planner, Observation(meshes=tasks.start), memory)
    problems = pose(planner, state, candidates, memory, LENGTH)
    found = planner.search(problems, keys(), length=LENGTH)
    plans = np.asarray(found.plan)
    offered = (planner, state, tasks.goal, plans, tasks.cloths.cloth, candidates)
    np.testing.assert_allclose(planning_losses(*offered, keys()), found.loss, rtol=1e-4)
    assert (np.abs(planning_losses(*offered, keys(1)) / found.loss - 1) > 1e-3).all()
    of_nets = (planner.model, planner.representation, planner.nets, problems, planner.objective(LENGTH))
    again = evaluated(*of_nets, plans, found.relative, keys())
    np.testing.assert_allclose(again.loss, found.loss, rtol=1e-4)


@pytest.mark.parametrize("name", ["b1", "b2"])
def test_recorded_plans_reach_their_goals(name: str) -> None:
    planner = replace(toy.planner(name), accuracy=Distance())
    assert (losses(planner) < losses(planner, 0.7)).all()
