"""Plans that are executed without a look in between, in the toy world."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.cloth.silhouette import centred
from clothkit.dataset.store import papers_cloths
from clothkit.episodes.open_loop import execute_plans, grasp_positions
from clothkit.planning.types import Plan
from clothkit.runtime.errors import InputError
from clothkit.simulation.cloths import Cloths
from tests.episodes.test_sessions import MANIPULATIONS
from tests.planning import toy

CENTRE = np.array([0.3, -0.2], np.float32)
LATER = np.array([17 / 31, 7 / 31, -19 / 31, 3 / 31, 0.6, -0.5], np.float32)
"""A manipulation whose hands lie on vertices that are no corners."""


def plan_of(manipulations: list[np.ndarray], right: int) -> tuple[Plan, list[np.ndarray]]:
    """A plan with predictions, of which those of net `right` come true, and the states on the table."""
    states, padding = [toy.bent() + np.append(CENTRE, 0)], 3 - len(manipulations)
    for manipulation in manipulations:
        states.append(np.asarray(toy.dragged(jnp.asarray(states[-1]), jnp.asarray(manipulation))))
    shapes, centres = (np.array(parts) for parts in zip(*map(centred, states), strict=True))
    means, shifts = np.zeros((1, 3, 2, 32, 32, 3), np.float32), np.ones((1, 3, 2, 2), np.float32)
    means[0, : len(manipulations), right] = shapes[1:]
    shifts[0, : len(manipulations), right] = np.diff(centres, axis=0)
    rows: dict[str, Any] = {
        "state": shapes[:1],
        "manipulations": np.pad(manipulations, [(0, padding), (0, 0)], constant_values=np.nan)[None],
        "means": means,
        "shifts": shifts,
    }
    for part in (means, shifts):
        part[:, len(manipulations) :] = np.nan
    return Plan(**{**dict.fromkeys(Plan._fields), **rows}), states


@pytest.mark.parametrize("best", [0, 1])
def test_a_plan_whose_predictions_come_true_ends_where_it_says(best: int) -> None:
    planner = toy.planner("b1")
    planner = dataclasses.replace(planner, best=best)
    manipulations = [MANIPULATIONS[0], LATER, MANIPULATIONS[2]]
    plan, states = plan_of(manipulations, right=best)
    positions = grasp_positions(planner, plan, np.array([centred(states[0])[1]]))
    executed = []

    def execute(*arguments: np.ndarray) -> np.ndarray:
        executed.append(arguments)
        return toy.execute(*arguments)

    start, centre = (part[None] for part in centred(states[0]))
    outcome = execute_plans(start, centre, plan.manipulations, positions, execute, papers_cloths(1))
    np.testing.assert_allclose(outcome[0], centred(states[3])[0], atol=2e-3)
    # A corner is grasped where the corner lies then.
    np.testing.assert_allclose(executed[0][1][0], np.repeat(states[0][:1, 0, :2], 2, axis=0), atol=1e-5)
    np.testing.assert_allclose(executed[2][1][0], np.repeat(states[2][:1, -1, :2], 2, axis=0), atol=1e-5)
    assert [call[3].tolist() for call in executed] == [[True], [False], [True]]
    assert np.abs(outcome[0] - centred(states[2])[0]).max() > 0.1


def test_null_manipulations_and_steps_after_the_end_are_not_executed() -> None:
    null = np.float32([-1, -1, -1, -1, 0.3, 0.3])
    plan, states = plan_of([null, MANIPULATIONS[0]], right=0)
    positions = grasp_positions(toy.planner("b1"), plan, np.array([centred(states[0])[1]]))
    assert np.isnan(positions[0, 2]).all()
    assert np.isfinite(positions[0, :2]).all()
    calls = []

    def execute(
        meshes: np.ndarray, grasps: np.ndarray, displacement: np.ndarray, single: np.ndarray, own: Cloths
    ) -> np.ndarray:
        calls.append(displacement)
        np.testing.assert_array_equal(own.cloth, cloths.cloth[:1])
        return meshes + np.float32([0.4, 0, 0.1])

    start = np.repeat(centred(states[0])[0][None], 2, axis=0)
    plans = np.concatenate([plan.manipulations, np.full((1, 3, 6), np.nan)])
    cloths = papers_cloths(2)
    cloths = cloths._replace(cloth=cloths.cloth * np.float32([[1, 0.5, 1], [1, 1, 1]]))
    outcome = execute_plans(
        start, np.zeros((2, 2), np.float32), plans, np.repeat(positions, 2, axis=0), execute, cloths
    )
    np.testing.assert_array_equal(calls, [MANIPULATIONS[None, 0, 4:]])
    # Outcomes are centred on the table, not in height.
    np.testing.assert_allclose(outcome - start, [np.broadcast_to([0, 0, z], (32, 32, 3)) for z in (0.1, 0)], atol=1e-3)
    with pytest.raises(InputError, match="manipulation 1 of a plan"):
        execute_plans(
            start[:1], CENTRE[None], plans[:1], positions, lambda meshes, *_: meshes * np.nan, papers_cloths(1)
        )
