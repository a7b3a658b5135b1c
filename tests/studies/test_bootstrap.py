"""The study of bootstrapped nets: what is drawn, and that differences are those of the rows."""

from importlib import import_module
from types import ModuleType

import numpy as np
import pytest

from tests import tiny, toy_dataset
from tests.evaluation.doubt_rows import probe_rows


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(tiny.ROOT / "studies")
    return import_module("bootstrap")


def test_each_member_has_sequences_of_its_own(study: ModuleType) -> None:
    dataset = toy_dataset.dataset(40)
    # A mark by which sequences are told apart.
    dataset.centre[:, 0, 0] = np.arange(40)
    found = [study.drawn(dataset, member).centre[:, 0, 0].astype(int).tolist() for member in (0, 1, 0)]
    assert found[0] == found[2] != found[1]
    for own in found:
        assert len(own) == 40
        # 63 % of the sequences are expected, some of them several times.
        assert 18 <= len(set(own)) <= 32


def test_differences_are_those_of_the_statistics(study: ModuleType) -> None:
    plain = probe_rows(20)
    rng = np.random.default_rng(1)
    # The same errors, a quarter smaller, of which the distance tells nothing any more, and the expected error all.
    own = plain.assign(error=0.75 * plain["error"], distance=rng.random(len(plain)), expected=plain["error"])
    found = study.compared(plain, own, draws=40).set_index(["group", "measure", "statistic"])
    mean = found.loc[("all", "error", "mean")]
    assert mean["plain"] == pytest.approx(plain["error"].mean())
    assert mean["difference"] == pytest.approx(-0.25 * plain["error"].mean())
    assert found.loc[("all", "expected", "rank"), "bootstrap"] == pytest.approx(1)
    assert found.loc[("step 1", "expected", "wrong"), "bootstrap"] == 1
    worse = found.loc[("all", "distance", "rank")]
    assert worse["difference"] == pytest.approx(worse["bootstrap"] - worse["plain"])
    assert worse["low"] < worse["difference"] < worse["high"] < -0.5
    same = found.loc[("all", "sigma", "rank")]
    assert same["difference"] == pytest.approx(0, abs=1e-12)
