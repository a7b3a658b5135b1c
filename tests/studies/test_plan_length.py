"""The study of the number of manipulations: its rows are the sessions', and its tables say what the rows say."""

from itertools import product
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from tests.episodes.test_sessions import MANIPULATIONS, dataset
from tests.planning import toy
from tests.planning.test_lengths import finding


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "studies"))
    import plan_length

    return plan_length


def test_rows_of_sessions_in_the_toy_world(study: ModuleType) -> None:
    """Searches from state 0 know the recorded manipulations; those from later states do not know what helps."""
    planner, data = toy.planner("b1"), dataset(1)
    with finding({n: MANIPULATIONS[:n] for n in (1, 2, 3)}):
        told = study.run(planner, data, [0], "test", "1", toy.execute, 0.01)
        chosen = study.run(planner, data, [0], "test", "chosen", toy.execute, 0.01)
    for rows in (told, chosen):
        assert rows[["start", "length"]].to_numpy().tolist() == [[0, 1], [1, 1], [2, 1], [0, 2], [1, 2], [0, 3]]
        assert set(rows["split"]) == {"test"}
        np.testing.assert_allclose(rows["expected_no_action"], rows["error_no_action"], atol=1e-5)
    assert (told["planned"] == 1).all()
    assert told["error"][0] < 0.01
    # From state 0, as many as were recorded; then nothing is left to improve, and the session is over.
    from_first = chosen[chosen["start"] == 0]
    assert from_first["planned"].tolist() == [1, 2, 3]
    assert from_first["used"].iloc[0] == 1
    assert from_first["error"].iloc[0] == pytest.approx(told["error"][0], abs=1e-6)
    none = chosen[chosen["planned"] == 0]
    np.testing.assert_allclose(none["error"], none["error_no_action"])
    assert (none["used"] == 0).all()


def rows(steps: str, *, error: float, expected: float, used: int, sequences: int = 12) -> pd.DataFrame:
    keys = pd.DataFrame(list(product(range(sequences), (1, 2))), columns=["sequence", "length"])
    return keys.assign(
        split="validation",
        system="main",
        steps=steps,
        start=0,
        planned=used,
        used=used,
        expected=expected,
        expected_no_action=0.3,
        error=error + 0.001 * keys["sequence"],
        error_no_action=0.4,
    )


@pytest.fixture
def table() -> pd.DataFrame:
    """One manipulation is expected to help much, two a bit more, three no more; and so it is."""
    values = {"1": (0.1, 0.08), "2": (0.09, 0.07), "3": (0.12, 0.07)}
    ways = [rows(steps, error=error, expected=expected, used=int(steps)) for steps, (error, expected) in values.items()]
    return pd.concat(ways, ignore_index=True)


def test_what_a_margin_would_have_chosen(study: ModuleType, table: pd.DataFrame) -> None:
    for margin, used, error in ((0.0, 2, 0.09), (0.005, 2, 0.09), (0.02, 1, 0.1), (0.5, 1, 0.1)):
        found = study.replayed(table, margin)
        assert len(found) == 24
        assert (found["used"] == used).all()
        np.testing.assert_allclose(found["error"], error + 0.001 * found["sequence"])
    # Where no number is expected to help, nothing is done.
    found = study.replayed(table.assign(expected_no_action=0.06), 0.0)
    assert (found["used"] == 0).all()
    assert (found["error"] == 0.4).all()


def test_the_largest_margin_that_is_as_good_as_the_best(study: ModuleType, table: pd.DataFrame) -> None:
    found = study.margins(table).set_index("margin")
    # All sequences agree that two are better than one, by 0.01: up to that, the margin costs nothing.
    assert found["chosen"][found["chosen"] == 1].index.tolist() == [0.0075]
    assert found["error"][0.0] == pytest.approx(0.09 + 0.001 * 5.5)
    assert found["difference"][0.02] == pytest.approx(0.01)
    # If half of the sequences lose and half win about as much, the difference is within its standard error.
    noisy = table.assign(error=table["error"] + 0.2 * (-1.0) ** table["sequence"] * (table["steps"] == "1"))
    found = study.margins(noisy).set_index("margin")
    assert found["chosen"][found["chosen"] == 1].index.tolist() == [0.1]


def test_the_summary_pairs_what_was_chosen_with_what_was_recorded(
    study: ModuleType, table: pd.DataFrame, tmp_path: Path
) -> None:
    whole = pd.concat([table, study.replayed(table, 0.005)[table.columns]], ignore_index=True)
    found = study.summary(whole).set_index(["steps", "column"])
    assert found["error"]["given", "1/all"] == pytest.approx(0.1 + 0.0055)
    assert found["error"]["given", "2/all"] == pytest.approx(0.09 + 0.0055)
    assert found["used"]["given", "all"] == pytest.approx(1.5)
    assert found["used"]["chosen", "all"] == pytest.approx(2)
    assert found["as_recorded"]["chosen", "1/all"] == 0
    assert found["as_recorded"]["chosen", "2/all"] == 1
    assert found["difference"]["chosen", "1/all"] == pytest.approx(-0.01)
    assert found["difference"]["chosen", "2/all"] == pytest.approx(0, abs=1e-12)
    assert found["difference_low"]["chosen", "1/all"] <= -0.01 + 1e-9
    assert found["difference"].drop("chosen", level="steps").isna().all()
    assert found["error_low"]["1", "1/all"] < found["error"]["1", "1/all"] < found["error_high"]["1", "1/all"]
    study.draw(found.reset_index(), tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
