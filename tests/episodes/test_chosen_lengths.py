"""Sessions in which the agent chooses how many manipulations end when nothing more is worth it."""

import numpy as np
import pytest

from clothkit.dataset.tasks import Task
from clothkit.episodes.sessions import run_sessions
from clothkit.evaluation.session_rows import rows
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.lengths import LengthConfig
from tests.episodes.test_sessions import MANIPULATIONS, tasks
from tests.planning import toy
from tests.planning.test_lengths import finding


def test_a_session_ends_when_nothing_more_is_worth_it() -> None:
    """Goals of one and two recorded folds, of which three are allowed, beside one that is reached already."""
    given = tasks(Task(0, 0, 1), Task(0, 0, 2), Task(1, 0, 1))
    goal = given.goal.copy()
    goal[2] = given.start[2]
    given = given._replace(task=[task._replace(length=3) for task in given.task], goal=goal, recorded=None)
    acted = []

    def execute(*arguments: np.ndarray) -> np.ndarray:
        acted.append(len(arguments[0]))
        return toy.execute(*arguments)

    plans = {n: MANIPULATIONS[:n] for n in (1, 2, 3)}
    with finding(plans):
        first = run_sessions(given, toy.planner("b1"), execute, length=LengthConfig())
    # In the first step two fold, and the third session is over; the first one's goal is reached then.
    assert acted[0] == 2
    done = ~first.null
    assert done[:, 0].tolist() == [True, True, False]
    assert not done[0, 1:].any()
    assert not done[2].any()
    # The record goes on to the end: nothing moves, and the last plan stands.
    for task, ended in ((0, 1), (2, 0)):
        for number in range(ended, 3):
            np.testing.assert_array_equal(first.state[task, number + 1], first.state[task, ended])
            np.testing.assert_array_equal(first.plan[task, number], first.plan[task, ended])
            assert first.null[task, number]
            assert not first.cancelled[task, number]
    tidy = rows(first, "b1")
    assert tidy["error"][0] < 0.01
    assert tidy["error"][2] == pytest.approx(0, abs=1e-6)
    assert tidy["nulls"].tolist()[0] == 2
    assert tidy["nulls"].tolist()[2] == 3
    assert np.isfinite(tidy[["error", "loss", "expected"]]).all(axis=None)


def test_a_session_ends_where_such_plans_made_things_worse() -> None:
    given = tasks(Task(0, 0, 1), Task(0, 0, 2))
    worse = ErrorMap(("expected",), np.ones(1), np.log(np.full(3, 9.0)), np.zeros(1), np.ones(1), np.ones((1, 3)))
    with finding({n: MANIPULATIONS[:n] for n in (1, 2, 3)}):
        sessions = run_sessions(given, toy.planner("b1"), toy.execute, length=LengthConfig(), trust=worse)
        free = run_sessions(given, toy.planner("b1"), toy.execute, length=LengthConfig())
    assert not free.null[:, 0].any()
    assert sessions.null[:, 0].all()
    np.testing.assert_array_equal(sessions.state[:, 1], sessions.state[:, 0])


def test_told_lengths_are_kept() -> None:
    """Without a choice, sessions go on to their length, though nothing is worth it."""
    given = tasks(Task(0, 0, 2))
    given = given._replace(goal=given.start)
    with finding({n: MANIPULATIONS[:n] for n in (1, 2, 3)}):
        sessions = run_sessions(given, toy.planner("b1"), toy.execute)
    assert sessions.null[0, :2].all()
    assert sessions.cancelled[0, :2].all()
    assert np.isfinite(sessions.error_otherwise[0, :2]).all()
