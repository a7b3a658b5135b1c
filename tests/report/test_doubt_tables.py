"""Tables of doubt: statistics by group, and plans by what was expected of them, against a count by hand."""

import numpy as np
import pytest

from clothkit.evaluation import doubt, tidy
from clothkit.planning.trust import INTERVAL, NEAR
from clothkit.report import doubt_tables
from clothkit.report.layout import PROBED, TRUST
from tests.evaluation.doubt_rows import probe_rows, trust_rows


def test_a_measure_that_tells_errors_stands_out() -> None:
    table = doubt_tables.doubt(doubt.summary(probe_rows(20)))
    assert list(table.columns) == ["statistic", "measure", *PROBED]
    wrong = table[table["statistic"] == "wrong"].set_index("measure")
    assert (wrong.loc["distance", list(PROBED)] > 0.85).all()
    assert wrong.loc["deviations", "all"] == pytest.approx(0.5, abs=0.1)


def test_plans_by_trust() -> None:
    rows = trust_rows(40)
    table = doubt_tables.trust(rows)
    assert list(table.columns) == list(TRUST)
    assert table["trust"].iloc[-1] == "all"
    assert table["plans"].iloc[-1] == len(rows) == table["plans"].iloc[:-1].sum()
    surest = rows[rows["trusted_trust"] >= 0.8]
    row = table.set_index("trust").loc["0.8 to 1"]
    assert row["plans"] == len(surest)
    assert row["came_true"] == pytest.approx((surest["error"] <= NEAR).mean())
    assert table["inside"].iloc[-1] == pytest.approx(INTERVAL, abs=0.1)
    assert np.diff(table["came_true"].iloc[:-1]).min() > -0.1


def test_made_up_rows_are_as_declared() -> None:
    for rows, schema in ((probe_rows(), tidy.PROBES), (trust_rows(), tidy.TRUST)):
        assert set(schema.columns) <= set(rows.columns)
