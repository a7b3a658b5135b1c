"""The number of manipulations is chosen by what each is expected to come to, and none is where nothing is worth it."""

import dataclasses
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.mesh import distance_aligned
from clothkit.cloth.symmetry import relabel
from clothkit.manipulation.vector import is_null
from clothkit.planning import agent
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.lengths import LengthConfig, chosen_lengths
from clothkit.planning.optimisers.random_shooting import RandomShootingConfig
from clothkit.planning.planner import Planner
from clothkit.planning.plans import pose
from clothkit.planning.types import Found, Memory, Observation, Plan, Problem
from tests.planning import toy

FOLDS = np.array([[-1, -1, -1, -1, 0.6, 0.5], [1, 1, 1, 1, -0.7, -0.3], [-1, 1, -1, 1, 0.5, -0.6]], np.float32)
ALWAYS = LengthConfig(margin=0.0)
distances = st.lists(st.floats(0, 2, width=32), min_size=2, max_size=4)


@given(distances, st.floats(0, 1, width=32))
def test_the_cheapest_number_by_brute_force(values: list[float], margin: float) -> None:
    expected = np.array([values[1:]])
    (found,) = chosen_lengths(np.array(values[:1]), expected, LengthConfig(margin=margin))
    costs = [value + margin * max(number - 1, 0) for number, value in enumerate(values)]
    assert costs[found] == min(costs)
    assert all(cost > costs[found] for cost in costs[:found])


@given(distances, st.floats(0, 1, width=32), st.floats(0, 1, width=32))
def test_a_larger_margin_never_takes_more_manipulations(values: list[float], one: float, other: float) -> None:
    now, expected = np.array(values[:1]), np.array([values[1:]])
    few, many = (
        int(chosen_lengths(now, expected, LengthConfig(margin=margin))[0])
        for margin in sorted((one, other), reverse=True)
    )
    assert few <= many


def test_where_there_is_no_plan_nothing_is_done() -> None:
    found = chosen_lengths(np.array([0.5, 0.5]), np.array([[np.inf, np.inf], [np.inf, 0.1]]), LengthConfig())
    assert found.tolist() == [0, 2]


def after(mesh: np.ndarray, folds: np.ndarray) -> np.ndarray:
    for fold in folds:
        mesh = np.asarray(toy.dragged(jnp.asarray(mesh), jnp.asarray(fold)))
    return mesh


def finding(plans: dict[int, np.ndarray]) -> Any:
    """In place of searches: as if they found these plans, by length."""

    def search(planner: Planner, problems: Problem, keys: Any, *, length: int) -> Found:
        tasks = len(problems.state)
        relative = np.maximum(np.asarray(problems.relative), 0)
        return Found(
            plan=jnp.broadcast_to(plans[length], (tasks, length, 6)),
            loss=jnp.zeros(tasks),
            terms={name: jnp.zeros((tasks, *size)) for name, size in (("accuracy", (2,)), ("uncertainty", ()))},
            common=jnp.zeros(tasks, jnp.int32),
            relative=jnp.asarray(relative),
            losses=jnp.zeros((tasks, *planner.settings.search.optimiser.shape(length))),
        )

    return mock.patch.object(Planner, "search", search)


def decided(
    planner: Planner,
    starts: np.ndarray,
    goals: np.ndarray,
    settings: LengthConfig | None,
    *,
    left: int = 3,
    trust: ErrorMap | None = None,
    sigma: np.ndarray | None = None,
) -> tuple[Plan, Memory]:
    memory = agent.begin(planner, goals, np.full(len(goals), left))
    keys = jax.random.split(jax.random.key(0), len(goals))
    seen = Observation(meshes=starts)
    return agent.decide(planner, seen, memory, key=keys, length=settings, trust=trust, sigma=sigma)


def test_as_many_manipulations_as_the_goal_takes() -> None:
    """Goals of none to three folds; searches know the folds, and no more."""
    start = toy.bent()
    goals = np.stack([after(start, FOLDS[:count]) for count in range(4)])
    starts = np.repeat(start[None], 4, axis=0)
    with finding({n: FOLDS[:n] for n in (1, 2, 3)}):
        plan, memory = decided(toy.planner("b1"), starts, goals, LengthConfig())
    assert plan.choice is not None
    assert plan.choice.length.tolist() == [0, 1, 2, 3]
    assert plan.length.tolist() == [1, 1, 2, 3]
    assert memory.left.tolist() == [0, 2, 2, 2]
    assert plan.null.tolist() == [True, False, False, False]
    # Where nothing is done, the plan is a null manipulation, and nothing is expected of it.
    assert is_null(plan.manipulations[0, 0])
    assert np.isfinite(plan.loss).all()
    assert plan.expected[0] == pytest.approx(0, abs=1e-6)
    np.testing.assert_array_equal(plan.manipulations[3], FOLDS)
    # What was expected of each number: by the nets' mean, against the goal.
    nets = [toy.NETS[0] * 1.0, toy.NETS[1] * 1.0]
    for task, count in ((3, 1), (3, 2), (2, 2)):
        means = []
        for net in nets:
            mesh = jnp.asarray(start)
            for number, fold in enumerate(FOLDS[:count]):
                mesh = toy.dragged(mesh, jnp.asarray(fold), net * (1 + toy.REMEMBERED * number))
            means.append(mesh)
        expected = float(distance_aligned(sum(means) / 2, goals[task]))
        assert plan.choice.expected[task, count] == pytest.approx(expected, abs=1e-5)
    for task in range(4):
        assert plan.choice.expected[task, 0] == pytest.approx(float(distance_aligned(start, goals[task])), abs=1e-6)


def test_no_more_than_are_left_and_no_further_one_that_is_not_worth_its_margin() -> None:
    start = toy.bent()
    goal = after(start, FOLDS)[None]
    with finding({n: FOLDS[:n] for n in (1, 2, 3)}):
        plan, memory = decided(toy.planner("b1"), start[None], goal, ALWAYS, left=2)
        dear, _ = decided(toy.planner("b1"), start[None], goal, LengthConfig(margin=5.0))
    assert plan.choice is not None
    assert plan.choice.length.tolist() == plan.length.tolist() == [2]
    assert np.isinf(plan.choice.expected[0, 3])
    assert memory.left.tolist() == [1]
    assert dear.choice is not None
    assert dear.choice.length.tolist() == [1]


def test_null_manipulations_do_not_count() -> None:
    """A search for three finds a pause and two folds: a plan of two, better than what the search for two finds."""
    start, pause = toy.bent(), np.array([[-1, -1, 1, 1, 0, 0]], np.float32)
    goal = after(start, FOLDS[:2])[None]
    other = np.repeat(FOLDS[2:], 2, axis=0)
    paused = np.concatenate([FOLDS[:1], pause, FOLDS[1:2]])
    with finding({1: other[:1], 2: other, 3: paused}):
        plan, memory = decided(toy.planner("b1"), start[None], goal, ALWAYS)
        told, _ = decided(toy.planner("b1"), start[None], goal, None)
    with finding({1: other[:1], 2: FOLDS[:2], 3: np.repeat(pause, 3, axis=0)}):
        same, _ = decided(toy.planner("b1"), start[None], goal, ALWAYS)
        ended, _ = decided(toy.planner("b1"), start[None], start[None], ALWAYS)
    for each in (plan, same):
        assert each.choice is not None
        assert each.choice.length.tolist() == each.length.tolist() == [2]
        np.testing.assert_array_equal(each.manipulations[0, :2], FOLDS[:2])
        assert np.isnan(each.manipulations[0, 2:]).all()
        assert np.isinf(each.choice.expected[0, 3])
        assert not each.null[0]
    assert memory.left.tolist() == [2]
    np.testing.assert_array_equal(memory.rest[0, 0], FOLDS[1])
    np.testing.assert_array_equal(plan.means, same.means)
    np.testing.assert_array_equal(plan.expected, same.expected)
    assert plan.loss[0] > 0  # its own: the search told none
    # Plans of pauses are none, however near their outcome seems to be.
    assert ended.choice is not None
    assert ended.choice.length.tolist() == [0]
    # Where the number is told, plans stay as they were found.
    np.testing.assert_array_equal(told.manipulations[0], paused)


def came_to(sign: str, factor: float) -> ErrorMap:
    """A map by which plans ended `factor` times the sign from their goals; plans of three twice as far."""
    return ErrorMap(
        (sign,), np.full(1, 1e-9), np.log(factor * np.array([1, 1, 2])), np.ones(1), np.ones(1), np.ones((1, 3))
    )


def test_nothing_is_done_where_such_plans_ended_farther_than_the_cloth_lies() -> None:
    """Goals of one to three folds, in a batch; perception is as unsure of each state as the cloth is far from its goal,
    so that by a map of this sign plans end 0.6 times as far as the cloth lies, and plans of three 1.2 times."""
    planner, start = toy.planner("b1"), toy.bent()
    goals = np.stack([after(start, FOLDS[:count]) for count in (1, 2, 3)])
    starts = np.repeat(start[None], 3, axis=0)
    now = np.array([float(distance_aligned(start, goal)) for goal in goals])
    with finding({n: FOLDS[:n] for n in (1, 2, 3)}):
        free, _ = decided(planner, starts, goals, LengthConfig())
        plan, memory = decided(planner, starts, goals, LengthConfig(), trust=came_to("sigma", 0.6), sigma=now)
        told, _ = decided(planner, starts, goals, None, trust=came_to("sigma", 9.0), sigma=now)
        # Without a sign that the map needs, or where perception is sure, it tells nothing or no harm.
        unknown, _ = decided(planner, starts, goals, LengthConfig(), trust=came_to("model_error", 9.0), sigma=now)
        sure, _ = decided(planner, starts, goals, LengthConfig(), trust=came_to("sigma", 9.0))
    assert free.choice is not None
    assert plan.choice is not None
    assert free.choice.length.tolist() == [1, 2, 3]
    assert plan.choice.length.tolist() == [1, 2, 0]
    assert memory.left.tolist() == [2, 2, 0]
    assert plan.null.tolist() == [False, False, True]
    assert is_null(plan.manipulations[2, 0])
    np.testing.assert_allclose(plan.expected[2], now[2], rtol=1e-5)
    # What each number was expected to come to is told all the same.
    np.testing.assert_array_equal(plan.choice.expected, free.choice.expected)
    np.testing.assert_array_equal(plan.manipulations[:2], free.manipulations[:2])
    for same in (unknown, sure):
        assert same.choice is not None
        assert same.choice.length.tolist() == [1, 2, 3]
    assert told.length.tolist() == [3, 3, 3]


def test_a_goal_in_other_labels_is_reached_already() -> None:
    planner = dataclasses.replace(toy.planner("main"), perception=toy.planner("b1").perception, labelled=False)
    goal = toy.bent(5)[None]
    with finding({n: FOLDS[:n] for n in (1, 2, 3)}):
        plan, memory = decided(planner, toy.bent()[None], goal, LengthConfig())
    assert plan.choice is not None
    assert plan.choice.length.tolist() == [0]
    assert memory.left.tolist() == [0]
    np.testing.assert_allclose(relabel(goal[0], int(plan.relative[0])), toy.bent(), atol=1e-6)


def test_a_longer_plan_than_what_was_left_begins_with_what_was_left() -> None:
    """One fold was planned first, then up to two: the search is given what is left, and null manipulations."""
    planner, start = toy.planner("b1"), toy.bent()
    goal = after(start, FOLDS)[None]
    with finding({n: FOLDS[:n] for n in (1, 2, 3)}):
        _, memory = decided(planner, start[None], goal, ALWAYS)
    assert memory.left.tolist() == [2]
    memory = memory._replace(rest=np.where(np.arange(3)[:, None] < 1, memory.rest, np.nan))
    problems = pose(planner, start[None], np.zeros((1, 12, 2), np.float32), memory, 2)
    carried = np.asarray(problems.carried[0])
    np.testing.assert_array_equal(carried[0], FOLDS[1])
    assert is_null(carried[1])


def test_the_chosen_plan_is_that_of_its_length() -> None:
    """With real searches: the same key, the same plan as when its length is told."""
    search = dataclasses.replace(toy.SEARCH, optimiser=RandomShootingConfig(plans=64, chunk=64, finalists=4))
    planner, start = toy.planner("b1"), toy.bent()
    planner = dataclasses.replace(planner, settings=dataclasses.replace(planner.settings, search=search))
    # An edge goes far: random plans are nearer to that than the cloth as it lies.
    goal = after(start, np.array([[1, -1, 1, 1, -1.2, 0]], np.float32))[None]
    plan, _ = decided(planner, start[None], goal, ALWAYS, left=1)
    told, memory = decided(planner, start[None], goal, None, left=1)
    assert plan.choice is not None
    assert plan.choice.length.tolist() == [1]
    assert told.choice is None
    assert memory.left.tolist() == [0]
    np.testing.assert_array_equal(plan.manipulations, told.manipulations)
    assert plan.choice.expected[0, 1] == pytest.approx(float(told.expected[0]))
