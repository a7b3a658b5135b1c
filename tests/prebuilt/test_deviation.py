"""What packing costs is measured on the same examples, and too much of it is an error."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.cloth.mesh import distance, distance_aligned
from clothkit.episodes.record import Sessions, Tasks, record, sizes_of
from clothkit.episodes.sessions import Execute
from clothkit.planning.planner import Planner
from clothkit.prebuilt.deviation import (
    HELD,
    MEASURES,
    all_tasks,
    check,
    deviation,
    deviations,
    expected_errors,
    first_plans,
    outcome_errors,
)
from clothkit.runtime.errors import InputError
from tests.episodes.test_sessions import MANIPULATIONS, dataset
from tests.planning import toy
from tests.planning.test_lengths import finding


def test_means_and_the_error_of_their_difference() -> None:
    found = deviation(np.array([0.1, 0.2, 0.3]), np.array([0.11, 0.23, 0.29]))
    assert (found.full, found.packed, found.count) == (0.2, 0.21, 3)
    # Differences 0.01, 0.03, -0.01: standard deviation 0.02.
    assert found.standard_error == pytest.approx(0.02 / np.sqrt(3), abs=1e-6)
    assert deviation(np.array([0.1]), np.array([0.1])).standard_error is None


def test_measures_of_two_toy_planners() -> None:
    """The full planner's first net is the toy world itself; the packed one's vertices follow hands a tenth too far."""
    full, data = toy.planner("b1"), dataset(2)
    packed = dataclasses.replace(full, nets=tuple(1.1 * net for net in full.nets))
    with finding({n: MANIPULATIONS[:n] for n in (1, 2, 3)}):
        found = deviations(full, packed, data, sequences=1, executed=0, execute=toy.execute)
    assert found.keys() == set(HELD)
    # Known meshes are no estimates, and both planners find the same plans here.
    assert (found["estimate"].full, found["estimate"].packed) == (0, 0)
    assert found["estimate"].count == 3
    assert found["plan"].full == found["plan"].packed > 0
    # Six tasks and two nets, by hand.
    expected = []
    for planner in (full, packed):
        errors = []
        for net in planner.nets:
            for task, way in zip(all_tasks(data, [0]).task, all_tasks(data, [0]).recorded or [], strict=True):
                mesh = jnp.asarray(way.states[0])
                for number, manipulation in enumerate(way.manipulations):
                    mesh = toy.dragged(mesh, jnp.asarray(manipulation), net * (1 + toy.REMEMBERED * number))
                errors.append(float(distance(mesh, way.states[task.length])))
        expected.append(np.mean(errors))
    assert found["prediction"].count == 12
    assert found["prediction"].full == pytest.approx(expected[0], rel=0.02)
    assert found["prediction"].packed == pytest.approx(expected[1], rel=0.02)
    assert found["prediction"].packed > found["prediction"].full
    check(
        {**found, "prediction": found["prediction"].model_copy(update={"packed": 1.01 * found["prediction"].full})}
        | flat(),
        within=0.02,
    )
    with pytest.raises(InputError, match=r"of predictions .* % above .* expected at most 2 %"):
        check(found | flat(), within=0.02)


def test_chance_is_not_held_against_them() -> None:
    """The same mean, 5 % too high: once on all examples, once by a single one."""
    full, sure = np.full(9, 0.1), np.full(9, 0.105)
    unsure = np.where(np.arange(9) == 0, 0.145, 0.1)
    rest = {name: deviation(full, full) for name in HELD}
    check({**rest, "plan": deviation(full, unsure)}, within=0.02)
    with pytest.raises(InputError, match=r"is 0\.1050 with packed nets, 5\.0 % above 0\.1000"):
        check({**rest, "plan": deviation(full, sure)}, within=0.02)


def flat() -> dict:
    """An estimate that is the same with both nets, and not zero."""
    return {"estimate": deviation(np.array([0.1, 0.1]), np.array([0.1, 0.1]))}


def test_plans_are_judged_by_the_full_nets() -> None:
    full, data = toy.planner("b1"), dataset(1)
    tasks = all_tasks(data, [0])
    rows = [row for row, task in enumerate(tasks.task) if task.start == 0]
    with finding({n: MANIPULATIONS[:n] for n in (1, 2, 3)}):
        plans = first_plans(full, tasks)
    found = expected_errors(full, tasks, plans)
    np.testing.assert_allclose(found[rows], plans.expected[rows], atol=1e-4)
    (first,) = [row for row in rows if tasks.task[row].length == 1]
    start = jnp.asarray(tasks.start[first])
    mean = sum(toy.dragged(start, jnp.asarray(MANIPULATIONS[0]), net) for net in full.nets) / 2
    assert found[first] == pytest.approx(float(distance_aligned(mean, tasks.goal[first])), abs=1e-5)


def test_outcomes_are_told_and_not_held(monkeypatch: pytest.MonkeyPatch) -> None:
    assert set(HELD) == set(MEASURES) - {"outcome"}
    data = dataset(1)
    tasks = all_tasks(data, [0])

    def replayed(tasks: Tasks, planner: Planner, execute: Execute, *, refined: bool) -> Sessions:
        """Sessions in which all that was recorded came about."""
        assert not refined, "nothing shows them"
        done = record(tasks, [], sizes_of(planner))
        for row, way in enumerate(tasks.recorded or []):
            done.state[row, : len(way.states)] = way.states
        return done

    monkeypatch.setattr("clothkit.prebuilt.deviation.run_sessions", replayed)
    np.testing.assert_allclose(outcome_errors(toy.planner("b1"), tasks, toy.execute), np.zeros(6), atol=1e-6)
