"""The study of optimisers: budgets are kept, and the summary says what the rows say."""

from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from clothkit.dataset.tasks import TASKS
from clothkit.episodes.sessions import run_sessions
from clothkit.evaluation.diagnosis import diagnosed
from clothkit.evaluation.session_rows import rows as session_rows
from clothkit.planning.optimisers import evaluations
from clothkit.planning.optimisers.gradient import GradientConfig
from tests.episodes.test_sessions import dataset
from tests.planning import toy

USUAL = GradientConfig(strains=64, base_iterations=10, iterations_per_step=10, screen=8, near=0.5)
"""The reference at `laptop`: 512 + 640 + 640 n evaluations and 64 exact ones, 640 + 640 n with gradients."""


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "studies"))
    import optimisers

    return optimisers


def test_contestants_in_the_toy_world(study: ModuleType) -> None:
    """All contestants get the problems and the keys of sessions' first searches, whichever sequences are asked for."""
    data, small = dataset(2), GradientConfig(strains=16, base_iterations=6, iterations_per_step=4, screen=4)
    planner = study.with_optimiser(toy.planner("b1"), small)
    posed = study.pose(planner, data, [0, 1])
    assert [(each.length, len(each.tasks.task)) for each in posed] == [(1, 6), (2, 4), (3, 2)]
    one = posed[0]
    row = study.size(study.Contestant("shooting", "evaluations", study.shooting), planner, small, one, None)
    assert row["evaluations"] == row["forward"] == 16 * 4 + 16 * 10 + 16
    assert row["seconds"] > 0
    plans = study.plans_of(planner, {1: small}, [one], "gradient, both")
    table = study.rows_of(plans, [one], toy.execute)
    assert table[["sequence", "start", "length"]].to_numpy().tolist() == [list(task) for task in one.tasks.task]
    assert table["error"].mean() < 0.5 * table["error_no_action"].mean()
    np.testing.assert_array_equal(table["search_failure"], table["loss"] > table["loss_recorded"])
    sessions = run_sessions(one.tasks, planner, toy.execute)
    np.testing.assert_array_equal(sessions.loss[:, 0], table["loss"])
    np.testing.assert_array_equal(diagnosed(sessions, one.tasks, planner).loss_recorded, table["loss_recorded"])
    # Sessions cancel what their null check finds useless.
    acted = ~sessions.cancelled[:, 0]
    of_sessions = session_rows(sessions, "b1")["error"].to_numpy()
    np.testing.assert_allclose(table["error"][acted], of_sessions[acted], atol=1e-6)
    assert acted.any()
    (other,) = study.only([one], {1})
    again = study.rows_of(study.plans_of(planner, {1: small}, [other], "gradient, both"), [other], None)
    columns = ["sequence", "start", "loss", "loss_recorded", "expected", "error_no_action"]
    np.testing.assert_allclose(again[columns], table.loc[table["sequence"] == 1, columns], rtol=1e-5)
    assert again["error"].isna().all()


@pytest.mark.parametrize("length", [1, 2, 3])
def test_as_many_evaluations(study: ModuleType, length: int) -> None:
    wanted = 1216 + 640 * length
    found = {}
    for name, budget, sizing in study.contestants(USUAL):
        for factor in (1, 2, 5):
            settings = sizing(factor * wanted, length)
            if budget != "both":
                # Populations are whole, and divided into equal chunks.
                assert evaluations(settings, length) == pytest.approx(factor * wanted, rel=0.01), name
            assert study.TEXT.validate_json(study.TEXT.dump_json(settings)) == settings
        found[name] = study.gradients(sizing(wanted, length), length)
    assert found["gradient"] == 640 * (1 + length)
    assert found["gradient_paper"] == 64 * round(wanted / 64 - 1)
    assert 0 < found["hybrid"] < found["gradient"]
    assert {name for name, count in found.items() if not count} == {
        *("shooting_500", "shooting", "cem", "mppi", "greedy")
    }


def test_summary(study: ModuleType) -> None:
    rows = [
        {
            "contestant": name,
            "budget": budget,
            "split": "validation",
            "sequence": sequence,
            "start": start,
            "length": length,
            "expected": 0.1,
            "error_no_action": 0.5,
            "loss": length + off,
            "search_failure": int(sequence % 2 == 0) if name == "cem" else 0,
            "error": 0.1 * length + off + 0.001 * sequence,
        }
        for name, budget, off in [("gradient", "both", 0.0), ("cem", "evaluations", 0.02), ("cem", "seconds", -0.01)]
        for sequence in range(12)
        for start, length in TASKS
    ]
    table = pd.DataFrame(rows)
    sizes = table[["contestant", "budget", "length"]].drop_duplicates().assign(seconds=2.0, settings="", fingerprint="")
    found = study.summary(table, sizes).set_index(["contestant", "budget", "length"])
    assert len(found) == 9
    one = found.loc[("cem", "evaluations", 2)]
    assert one["tasks"] == 24
    assert one["error"] == pytest.approx(0.2 + 0.02 + 0.0055)
    assert one["error_low"] < one["error"] < one["error_high"]
    assert one["search_failures"] == pytest.approx(0.5)
    # Each of 12 sequences is worse by as much, so that the interval is a point and only equal signs are as far.
    assert one[["error_difference", "error_difference_low", "error_difference_high"]].tolist() == pytest.approx(
        [0.02] * 3
    )
    assert one["error_p"] == pytest.approx(2 * 0.5**12, abs=1e-3)
    assert found.loc[("cem", "seconds", 3), "error_difference"] == pytest.approx(-0.01)
    assert found.loc[("cem", "seconds", 3), "search_failures_difference"] == pytest.approx(0.5)
    assert np.isnan(found.loc[("gradient", "both", 1), "error_difference"])
    assert (found["seconds"] == 2).all()
    without = study.summary(table.assign(error=np.nan), sizes).set_index(["contestant", "budget", "length"])
    assert without[["error", "error_low", "error_difference", "error_p"]].isna().all(axis=None)
    assert without["search_failures"].tolist() == found["search_failures"].tolist()
