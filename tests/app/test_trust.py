"""What is told of a plan's trust: by the map that the nets' folder has, for the system that it was made with."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from clothkit.app.advice import warning_of
from clothkit.app.inputs import load_settings
from clothkit.app.plan import summary
from clothkit.app.plan_file import UNLIKELY, WORSE, plan_of
from clothkit.app.planner import Planned, trusted_of
from clothkit.planning import error_map, trust
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.systems import SYSTEMS
from clothkit.runtime.errors import InputError
from tests.app.plans import content

RATIOS = np.linspace(0.5, 1.5, 21)
MAP = ErrorMap(
    trust.Signs._fields, np.full(3, 0.002), np.log([1.0, 2.0, 3.0]), np.array([0.5, 0.5, 0.0]),
    np.ones(1), RATIOS[None],
)  # fmt: skip
PLANNED = Planned(
    np.zeros((2, 2, 3)), np.zeros((2, 6)), 0, 0, np.zeros((1, 2, 2, 2, 3)), None, np.zeros((2, 2)), None, (),
    expected=0.01, model_error=0.04, sigma=0.02,
)  # fmt: skip


def test_by_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "normalisation").mkdir()
    assert load_settings(tmp_path).trust is None
    error_map.save(tmp_path / trust.PLACE, MAP, {})
    settings = load_settings(tmp_path)
    told = trusted_of(PLANNED, settings, SYSTEMS["main"])
    assert told is not None
    # Two manipulations: twice the geometric mean of both errors.
    expected = 2 * np.sqrt(0.012 * 0.042)
    assert told.error[0] == pytest.approx(expected, rel=1e-5)
    assert told.low[0] == pytest.approx(0.6 * expected, rel=1e-5)
    assert told.high[0] == pytest.approx(1.4 * expected, rel=1e-5)
    # Ratios are uniform from 0.5 to 1.5, and an outcome comes true up to 0.05.
    assert told.trust[0] == pytest.approx(trust.NEAR / expected - 0.5, rel=1e-4)
    # The map was made with main; and without a sign that it needs it says nothing.
    assert trusted_of(PLANNED, settings, SYSTEMS["b1"]) is None
    # Of a plan that was searched for within limits, no better end is told than it expects.
    within = trusted_of(
        PLANNED._replace(expected=0.2, model_error=0.001, without_limits=0.1), settings, SYSTEMS["main"]
    )
    free = trusted_of(PLANNED._replace(expected=0.2, model_error=0.001), settings, SYSTEMS["main"])
    assert within is not None
    assert free is not None
    assert free.error[0] < within.error[0] == pytest.approx(0.2)
    assert within.trust[0] <= free.trust[0]
    assert trusted_of(PLANNED._replace(model_error=np.nan), settings, SYSTEMS["main"]) is None
    some = dataclasses.replace(MAP, signs=("expected", "sigma"), least=MAP.least[:2], slope=MAP.slope[:2])
    error_map.save(tmp_path / trust.PLACE, some, {})
    assert trusted_of(PLANNED._replace(model_error=np.nan), load_settings(tmp_path), SYSTEMS["main"]) is not None
    (tmp_path / trust.PLACE).write_text("{")
    with pytest.raises(InputError, match=r"trust\.json"):
        load_settings(tmp_path)


def test_it_is_told_in_millimetres() -> None:
    given = content("main")
    assert "trust" not in summary(plan_of(given), Path("plan.json"))
    lengths = {"outcome_error_m": 0.012, "outcome_error_low_m": 0.004, "outcome_error_high_m": 0.025, "trust": 0.875}
    told = summary(plan_of({**given, "expected": {**given["expected"], **lengths}}), Path("plan.json"))
    assert "such plans ended 12 mm from their goals, 80 % of them 4 to 25 mm; trust 0.88" in told
    assert "u = 0.1, the nets differ by 0, 0 mm" in told
    # A search weighs one of both measures; where none is told, how far the nets differ still is.
    other = {"prediction_error_m": 0.0314, "epistemic_uncertainty": None}
    told = summary(plan_of({**given, "expected": {**given["expected"], **other}}), Path("plan.json"))
    assert "the predicted outcome is expected to be 31 mm off, the nets differ by 0, 0 mm" in told
    assert "u =" not in told


def test_a_plan_whose_like_made_things_worse_is_warned_of() -> None:
    assert warning_of(True, 0.2, 0.1) == WORSE
    assert warning_of(False, 0.2, 0.1) == UNLIKELY
    assert warning_of(True, 0.1, 0.1) is None
    assert warning_of(True, None, 0.1) is None
    assert warning_of(True, 0.2, None) is None
