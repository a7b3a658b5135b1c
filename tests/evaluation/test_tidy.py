"""Tidy tables with each fault, one by one: a sentence that names the file, the column and what was expected."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from clothkit.dataset.tables import Table, read
from clothkit.evaluation import calibration, camera_planning, planning, tidy
from clothkit.runtime.errors import InputError
from tests.evaluation import camera_rows
from tests.evaluation.planning_rows import planning_rows
from tests.report.contents import tidy_estimates, tidy_tasks


def curves() -> pd.DataFrame:
    curve = calibration.curve(np.full((1, 4, 4, 3), 0.5))
    return pd.concat([curve.assign(split="test", system="main", length=n) for n in (1, 2, 3)], ignore_index=True)


HEALTHY: dict[str, tuple[Table, Callable[[], pd.DataFrame]]] = {
    "estimation": (tidy.ESTIMATION, tidy_estimates),
    "prediction": (tidy.PREDICTION, lambda: tidy_tasks(("main", "a1", "a2"))),
    "calibration": (tidy.CALIBRATION, curves),
    "planning": (tidy.PLANNING, planning_rows),
    "planning, terms of three nets": (
        tidy.PLANNING,
        lambda: planning_rows().assign(uncertainty=0.1, accuracy_0=0.5, accuracy_1=np.nan, accuracy_2=-0.5),
    ),
    "no layer over another": (tidy.PLANNING, lambda: planning_rows().assign(layers_reversed=np.nan)),
    "comparisons": (tidy.COMPARISONS, lambda: planning.comparisons(planning_rows(("main", "b1")))),
    "intervals": (tidy.INTERVALS, lambda: planning.intervals(planning_rows(("main",)))),
    "one sequence": (tidy.INTERVALS, lambda: planning.intervals(planning_rows(("main",), sequences=1))),
    "failures": (tidy.FAILURES, lambda: planning.failures(planning_rows())),
    "failures of these": (
        tidy.FAILURES,
        lambda: planning.failures(planning_rows().assign(layers_reversed=np.nan)),
    ),
    "camera_estimation": (tidy.CAMERA_ESTIMATION, camera_rows.estimation),
    "camera_planning": (tidy.CAMERA_PLANNING, camera_rows.planning),
    "camera_comparisons": (tidy.COMPARISONS, lambda: camera_planning.comparisons(camera_rows.planning())),
    "history": (tidy.HISTORY, lambda: pd.DataFrame({"iteration": [1, 5, 9], "score": 0.1, "1/0": 0.2})),
}


@pytest.mark.parametrize(("table", "make"), HEALTHY.values(), ids=HEALTHY)
def test_what_evaluations_make_is_read_as_it_is(tmp_path: Path, table: Table, make: Callable[[], pd.DataFrame]) -> None:
    rows = make()
    rows.to_parquet(tmp_path / "rows.parquet", index=False)
    pd.testing.assert_frame_equal(read(tmp_path / "rows.parquet", table), rows, check_dtype=False)
    first = next(name for name, column in table.columns.items() if not column.optional)
    rows.drop(columns=first).to_parquet(tmp_path / "rows.parquet", index=False)
    with pytest.raises(InputError, match=rf"rows\.parquet: has no column {first}"):
        read(tmp_path / "rows.parquet", table)


def cell(column: str, value: Any, row: int = 3) -> Callable[[pd.DataFrame], pd.DataFrame]:
    def change(rows: pd.DataFrame) -> pd.DataFrame:
        values = rows[column].tolist()
        values[row] = value
        return rows.assign(**{column: values})

    return change


FAULTS: list[tuple[str, Callable[[pd.DataFrame], pd.DataFrame], str]] = [
    (
        "planning",
        cell("error", np.nan),
        r"column error: expected numbers 0 to 1e\+06, found nothing .*sequence 0",
    ),
    ("planning", cell("error", np.inf), r"column error: expected numbers 0 to 1e\+06, found inf"),
    ("planning", cell("error", 1e9), r"column error: expected numbers 0 to 1e\+06, found 1e\+09"),
    ("planning", cell("error", -0.1), r"column error: expected numbers 0 to 1e\+06, found -0\.1"),
    ("planning", cell("voxel_error", 1.5), r"column voxel_error: expected numbers 0 to 1, found 1\.5"),
    ("planning", cell("start", 7), "column start: expected whole numbers 0 to 2, found 7"),
    ("planning", cell("start", 2), "start, length of split test, .*expected tasks that end at state 3 or before"),
    ("planning", cell("length", 0), "column length: expected whole numbers 1 to 3, found 0"),
    ("planning", cell("split", "exam"), r"column split: expected text \(train, validation, test\), found 'exam'"),
    ("planning", cell("split", None), "column split: .* found nothing"),
    ("planning", lambda rows: rows.assign(error="small"), r"column error: expected numbers 0 to 1e\+06, found "),
    ("planning", lambda rows: rows.assign(error=None), r"column error: expected numbers 0 to 1e\+06, found null"),
    (
        "planning",
        lambda rows: rows.assign(grasp_offered=1),
        "column grasp_offered: expected true or false, found",
    ),
    ("planning", lambda rows: rows.assign(accuracy_0=np.inf), "column accuracy_0: expected numbers or nothing, found"),
    ("planning", lambda rows: rows.assign(accuracy_12="low"), "column accuracy_12: expected numbers or nothing, found"),
    ("planning", lambda rows: rows.drop(index=4), "split test, system main, sequence 0: expected every task"),
    ("planning", lambda rows: pd.concat([rows, rows[4:5]]), "expected one row for each split, system, sequence, start"),
    ("planning", lambda rows: rows[:0], "expected at least one row, found none"),
    ("estimation", cell("kind", "mesh"), r"column kind: expected text \(pmr, dmr\), found 'mesh'"),
    ("estimation", cell("state", 0), "column state: expected whole numbers 1 to 3, found 0"),
    ("estimation", lambda rows: rows.drop(index=2), "expected every state from 1 on"),
    ("prediction", cell("error", np.nan), "system, error of split test, system main, .* all systems but main_occluded"),
    ("prediction", lambda rows: rows.drop(index=2), "expected every task of the sequence"),
    ("prediction", cell("position_error", np.nan), "column position_error: .* found nothing"),
    ("calibration", cell("coverage", 1.2), r"column coverage: expected numbers 0 to 1, found 1\.2"),
    ("calibration", cell("expected", 0.9), "z, expected of .*expected to be a normal distribution's share"),
    ("comparisons", cell("low", 5.0), "low, high of .*: expected low at or below high, or neither"),
    ("comparisons", cell("p", 2.0), "column p: expected numbers 0 to 1 or nothing, found 2"),
    ("comparisons", lambda rows: rows[:0], "expected at least one row"),
    ("intervals", cell("sequences", 0), "column sequences: expected whole numbers from 1 on, found 0"),
    ("failures", cell("length", "4"), r"column length: expected text \(1, 2, 3, all\), found '4'"),
    ("camera_estimation", cell("tilt", 20.0), r"column tilt: expected numbers 0 to 1\.5708, found 20"),
    ("camera_estimation", cell("iou", np.nan), "seen, iou of .*: expected iou to be a number where the cloth was seen"),
    ("camera_planning", cell("iou", 2.0), "column iou: expected numbers 0 to 1, found 2"),
    ("history", cell("iteration", 3, 2), "iteration of .*: expected more than in the row before"),
    ("history", cell("score", np.nan, 1), "column score: .* found nothing"),
]


@pytest.mark.parametrize(("name", "damage", "sentence"), FAULTS, ids=[f"{n}-{s[:30]}" for n, _, s in FAULTS])
def test_a_fault_is_one_sentence(
    tmp_path: Path, name: str, damage: Callable[[pd.DataFrame], pd.DataFrame], sentence: str
) -> None:
    table, make = HEALTHY[name]
    damage(make()).to_parquet(tmp_path / "rows.parquet", index=False)
    with pytest.raises(InputError, match=sentence) as told:
        read(tmp_path / "rows.parquet", table)
    assert str(told.value).startswith(f"{tmp_path}/rows.parquet: ")
    assert len(str(told.value).splitlines()) == 1


def test_comparisons_of_planners_may_be_none(tmp_path: Path) -> None:
    planning.comparisons(planning_rows(("main",))).to_parquet(tmp_path / "rows.parquet")
    assert read(tmp_path / "rows.parquet", tidy.ANY_COMPARISONS).empty


def test_a_table_of_some_columns_is_read_by_these(tmp_path: Path) -> None:
    rows = planning_rows(("main",))[["split", "sequence", "start", "length", "error"]]
    rows.to_parquet(tmp_path / "rows.parquet", index=False)
    pd.testing.assert_frame_equal(read(tmp_path / "rows.parquet", tidy.PLANNING, list(rows)), rows, check_dtype=False)
    with pytest.raises(InputError, match="has no column system, expected split, system"):
        read(tmp_path / "rows.parquet", tidy.PLANNING, ("split", "system"))
