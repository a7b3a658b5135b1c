"""Tables of named goals: means over repeats by goal and source, with what doing nothing comes to."""

import math
import statistics

import pytest

from clothkit.report.goal_tables import goals
from tests.goals.goal_rows import goal_rows


def test_means_by_goal_and_source() -> None:
    table = goals(goal_rows(), "error")
    assert table["goal"].tolist() == ["half"] * 4 + ["quarter"] * 4
    assert table["source"].tolist() == ["mesh", "camera", "script", "no action"] * 2
    assert table["manipulations"].tolist() == [1] * 4 + [2] * 4
    assert (table["cloths"] == 2).all()
    rows = table.set_index(["goal", "source"])
    # Of the repeats 0.02 and 0.022, and 0.1 more from a heap.
    assert rows.loc[("half", "mesh"), "flat"] == pytest.approx(0.021)
    assert rows.loc[("half", "mesh"), "crumpled"] == pytest.approx(0.121)
    assert rows.loc[("quarter", "camera"), "dragged"] == pytest.approx(0.041)
    assert rows.loc[("half", "no action"), "flat"] == pytest.approx(0.3)
    assert math.isnan(rows.loc[("half", "script"), "dragged"])


def test_the_spread_over_cloths() -> None:
    rows = goals(goal_rows(repeats=4), "error").set_index(["goal", "source"])
    # Of 0, 2, 4 and 6 thousandths.
    for start in ("flat", "dragged", "crumpled"):
        assert rows.loc[("half", "camera"), f"{start}_std"] == pytest.approx(0.002 * statistics.stdev(range(4)))
    assert rows.loc[("half", "no action"), "flat_std"] == pytest.approx(0)
    assert math.isnan(rows.loc[("half", "script"), "dragged_std"])
    assert goals(goal_rows(repeats=1), "error")["flat_std"].isna().all()


def test_what_a_goal_has_no_measure_of_is_left_out() -> None:
    table = goals(goal_rows(), "softgym")
    assert set(table["goal"]) == {"half"}
    assert table.loc[table["source"] == "mesh", "flat"].item() == pytest.approx(0.042)
    assert table.loc[table["source"] == "no action", "flat"].item() == pytest.approx(0.5)


def test_without_plans_there_are_scripts_alone() -> None:
    rows = goal_rows()
    table = goals(rows[rows["source"] == "script"], "error")
    assert table["source"].tolist() == ["script", "no action"] * 2
