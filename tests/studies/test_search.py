"""What the study of searches makes of the times of its calls."""

from importlib import import_module

import pytest

from tests import tiny


def test_the_first_call_is_left_out_and_a_padded_one_takes_as_long_as_a_full_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(tiny.ROOT / "studies")
    times = {
        "1": [(20, 90.0), (20, 6.0), (5, 4.0)],  # 5 s a batch of 20, in the mean
        "2": [(20, 90.0), (5, 8.0)],
        "3": [(20, 70.0)],
        "estimates": [(9, 1.0), (9, 1.0)],
    }
    assert import_module("search").seconds_per_plan(times) == {1: pytest.approx(0.25), 2: pytest.approx(0.4)}
