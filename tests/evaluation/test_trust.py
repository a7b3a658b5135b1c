"""Trust in the toy world: plans, what came of them, and what is told of others."""

from pathlib import Path

import numpy as np
import pytest

from clothkit.cloth.mesh import distance_aligned
from clothkit.dataset.store import SPLITS, Dataset
from clothkit.evaluation.settings import CalibrateConfig
from clothkit.evaluation.trust import Planned, execute_planned, rows
from clothkit.planning import trust
from tests import toy_dataset
from tests.planning import toy

SEQUENCES = 2
"""So many are planned for; there is one more, which comes first."""


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    found = toy_dataset.dataset(SEQUENCES + 1)
    found.split[:] = SPLITS.index("validation")
    return found


def test_plans_are_executed_to_their_end_and_a_killed_run_goes_on(dataset: Dataset, tmp_path: Path) -> None:
    planner, calls = toy.planner("b1"), []

    def execute(*arguments: np.ndarray) -> np.ndarray:
        calls.append(len(arguments[0]))
        return toy.execute(*arguments)

    found = execute_planned(dataset, CalibrateConfig(sequences=SEQUENCES), planner, execute, work=tmp_path)
    assert len(found.sequence) == 6 * SEQUENCES
    assert set(found.sequence) == {1, 2}
    assert set(zip(found.start, found.length, strict=True)) == {(0, 1), (1, 1), (2, 1), (0, 2), (1, 2), (0, 3)}
    # The toy's nets know their world to 3 %: plans end near their goals, and as near as they expect.
    done = found.error < 0.5 * found.error_no_action
    assert done.mean() > 0.5
    np.testing.assert_allclose(found.error[done], found.expected[done], atol=0.03)
    assert not found.sigma.any()
    assert np.isnan(found.model_error).all()
    for row, (s, i, n) in enumerate(zip(found.sequence, found.start, found.length, strict=True)):
        apart = distance_aligned(dataset.vertices[s, i], dataset.vertices[s, i + n])
        assert found.error_no_action[row] <= float(apart) + 1e-6
    before = len(calls)
    again = execute_planned(dataset, CalibrateConfig(sequences=SEQUENCES), planner, execute, work=tmp_path)
    assert len(calls) == before
    for one, other in zip(found, again, strict=True):
        np.testing.assert_array_equal(one, other)


def planned(seed: int, sequences: int) -> Planned:
    """Plans whose real error is three times what the nets expect of it, times noise."""
    rng, count = np.random.default_rng(seed), 6 * sequences
    length = np.tile([1, 1, 1, 2, 2, 3], sequences)
    expected, model_error = rng.uniform(0.01, 0.05, count), rng.uniform(0.01, 0.1, count)
    error = 3 * length * np.sqrt(expected * model_error) * rng.lognormal(0, 0.3, count)
    sequence = np.repeat(np.arange(sequences), 6)
    return Planned(sequence, 0 * length, length, expected, model_error, np.full(count, 0.01), error, np.ones(count))


def test_trust_of_others_holds() -> None:
    table, found = rows(planned(0, 400))
    assert found.signs == trust.names_of("expected")
    inside = (table["trusted_low"] <= table["error"]) & (table["error"] <= table["trusted_high"])
    assert inside.mean() == pytest.approx(trust.INTERVAL, abs=0.04)
    came_true = table["error"] <= trust.NEAR
    for low, high in ((0.0, 0.4), (0.4, 1.0)):
        chosen = (low < table["trusted_trust"]) & (table["trusted_trust"] <= high)
        assert came_true[chosen].mean() == pytest.approx(table.loc[chosen, "trusted_trust"].mean(), abs=0.06)
    others = planned(1, 50)
    signs = trust.Signs(others.expected, others.model_error, others.sigma)
    told = trust.trusted(found, signs, others.length)
    assert np.mean(others.error / told.error) == pytest.approx(1, abs=0.07)
    assert ((told.low < told.error) & (told.error < told.high)).all()


def test_what_is_told_of_a_plan_owes_nothing_to_its_own_sequence() -> None:
    """Not even the interval and the trust: another outcome of a sequence's plans changes only what others are told."""
    given = planned(3, 12)
    own = given.sequence == 5
    before = rows(given)[0]
    after = rows(given._replace(error=np.where(own, 20 * given.error, given.error)))[0]
    names = [f"trusted_{name}" for name in trust.Trusted._fields]
    np.testing.assert_array_equal(after.loc[own, names], before.loc[own, names])
    assert (after.loc[given.sequence == 6, "trusted_high"] != before.loc[given.sequence == 6, "trusted_high"]).all()


def test_signs_that_a_planner_lacks_are_no_part_of_the_map() -> None:
    given = planned(2, 20)
    table, found = rows(given._replace(model_error=np.full(len(given.error), np.nan)))
    assert found.signs == trust.names_of("paper")
    assert np.isfinite(table["trusted_error"]).all()
