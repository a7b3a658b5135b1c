"""Metrics: every mean of the tables as a row, and at most 20 of them for `dvc exp show`."""

import json
from typing import Any

import pandas as pd
import pytest

from clothkit.evaluation import planning
from clothkit.report import metrics, planning_tables, tables
from tests.evaluation.planning_rows import planning_rows
from tests.report.contents import tidy_estimates, tidy_tasks

PLANNERS = ("main", "b1", "b2", "b3", "b4", "b5", "unrefined", *(f"mine_{number}" for number in range(5)))


@pytest.fixture(scope="module")
def planned() -> pd.DataFrame:
    return planning_rows(PLANNERS, sequences=2)


@pytest.fixture(scope="module")
def rows(planned: pd.DataFrame) -> pd.DataFrame:
    tidy, intervals = tidy_tasks(("main", "a1")), planning.intervals(planned)
    return metrics.means(
        estimation=tables.estimation(tidy_estimates()),
        prediction=tables.prediction(tidy, ("main", "a1")),
        prediction_voxels=tables.prediction(tidy, ("main", "a1")),
        position=tables.position(tidy, ("main", "a1")),
        planning=planning_tables.planning(planned, intervals, PLANNERS),
        planning_voxels=planning_tables.planning_voxels(planned, intervals, PLANNERS),
        sigma_ratio=tables.sigma_ratio(tidy_estimates(), tidy),
    )


def mean(rows: pd.DataFrame, **of: str) -> float:
    """The only mean of that name."""
    found = rows[(rows[list(of)] == pd.Series(of)).all(axis=1)]
    assert len(found) == 1
    return float(found["mean"].iloc[0])


def test_every_mean_is_a_row(rows: pd.DataFrame, planned: pd.DataFrame) -> None:
    voxels = planned.query("split == 'train' and system == 'b4' and length == 3")["voxel_error"]
    found = mean(rows, measure="planning_voxels", split="train", system="b4", column="3/all")
    assert found == pytest.approx(voxels.mean())
    assert mean(rows, measure="estimation", split="test", system="pmr", column="1") == pytest.approx(0.011)
    assert mean(rows, measure="prediction", split="test", system="no action", column="3/all") == pytest.approx(0.515)
    assert mean(rows, measure="position", split="test", system="main", column="2") == pytest.approx(0.035)
    assert mean(rows, measure="sigma_ratio", split="test", system="main", column="estimate") == pytest.approx(0.8)
    assert not rows.duplicated(["measure", "split", "system", "column"]).any()
    assert rows["mean"].notna().all()


def figures(nested: Any) -> list[float]:
    """The leaves."""
    return [leaf for value in nested.values() for leaf in figures(value)] if isinstance(nested, dict) else [nested]


def test_headline_figures_are_few(rows: pd.DataFrame, planned: pd.DataFrame) -> None:
    found = metrics.headline(rows, PLANNERS)
    assert 15 <= len(figures(found)) <= 20
    json.dumps(found, allow_nan=False)
    by_length = planned.query("split == 'test' and system == 'main'").groupby("length")["error"].mean()
    assert found["planning"]["main"] == {
        str(length): pytest.approx(by_length[length], abs=1e-6) for length in (1, 2, 3)
    }
    others = planned.query("split == 'test' and length == 3").groupby("system")["error"].mean()
    assert found["planning"]["b5"] == {"3": pytest.approx(others["b5"], abs=1e-6)}
    assert found["estimation"] == {"pmr": pytest.approx(0.021), "dmr": pytest.approx(0.121)}
    assert set(found["prediction"]) == {"1", "2", "3"}
    assert set(found["sigma_ratio"]) == {"estimate", "1", "2", "3"}


def test_what_was_not_measured_has_no_figure(rows: pd.DataFrame) -> None:
    kept = rows[(rows["measure"] != "sigma_ratio") & (rows["system"] != "b1")]
    found = metrics.headline(kept, ("main", "b1", "b2"))
    assert found["sigma_ratio"] == {}
    assert list(found["planning"]) == ["main", "b2"]
