"""What `dvc plots` draws: a line or bar per system, as the tables and rows say."""

import numpy as np
import pandas as pd
import pytest

from clothkit.evaluation import planning
from clothkit.report import planning_tables, tables
from clothkit.report.plots import plots
from tests.evaluation.planning_rows import planning_rows
from tests.report.contents import tidy_tasks

PLANNERS = ("main", "b1", "b4")


@pytest.fixture(scope="module")
def planned() -> pd.DataFrame:
    return planning_rows(PLANNERS)


@pytest.fixture(scope="module")
def drawn(planned: pd.DataFrame) -> dict[str, pd.DataFrame]:
    histories = {
        name: pd.DataFrame({"iteration": [10, 20], "score": [0.4, score], "1/0": [0.3, 0.2]})
        for name, score in (("pemd_0", 0.1), ("pemd_1", 0.2), ("vtm", 0.3))
    }
    z = pd.DataFrame({"z": [2.0, 1.0], "expected": [0.954, 0.683], "coverage": [0.9, 0.6]})
    calibration = pd.concat(
        [
            z.assign(split=split, system=system, axis=axis, length=length)
            for split in ("test", "train")
            for system in ("estimate", "main", "a1")
            for axis in ("all", "xy", "z")
            for length in (1, 2, 3)
        ]
    )
    table_3 = tables.prediction(tidy_tasks(("main", "a1")), ("main", "a1"))
    table_6 = planning_tables.planning(planned, planning.intervals(planned), PLANNERS)
    return plots(histories, calibration, table_3, table_6)


def test_learning_has_a_line_per_net(drawn: dict[str, pd.DataFrame]) -> None:
    last = drawn["learning"].query("iteration == 20").set_index("line")["error"]
    assert last.to_dict() == {"pemd_0": 0.1, "pemd_1": 0.2, "vtm": 0.3}
    assert len(drawn["learning"]) == 6


def test_calibration_begins_at_the_origin_and_has_the_diagonal(drawn: dict[str, pd.DataFrame]) -> None:
    lines = dict(list(drawn["calibration"].groupby("line")))
    names = {f"{what}, {length}" for what in ("estimates", "predictions") for length in (1, 2, 3)}
    assert set(lines) == {"ideal", *names}
    np.testing.assert_array_equal(
        lines["predictions, 2"][["expected", "coverage"]], [[0, 0], [0.683, 0.6], [0.954, 0.9]]
    )
    np.testing.assert_array_equal(lines["ideal"]["expected"], lines["ideal"]["coverage"])


def test_errors_are_means_of_the_test_split(drawn: dict[str, pd.DataFrame], planned: pd.DataFrame) -> None:
    test = planned[planned["split"] == "test"]
    by_length = test.groupby(["system", "length"])["error"].mean()
    rows = drawn["planning"]
    assert len(rows) == 9
    for row in rows.to_dict("records"):
        assert row["error"] == pytest.approx(by_length[row["line"], int(row["length"])])
    by_task = test.groupby(["system", "length", "start"])["error"].mean()
    bars = drawn["table_6"].set_index(["system", "task"])["error"]
    assert bars["b4", "2/1"] == pytest.approx(by_task["b4", 2, 1])
    assert set(drawn["prediction"]["line"]) == {"main", "a1"}
    assert list(drawn["prediction"]["length"].unique()) == ["1", "2", "3"]
