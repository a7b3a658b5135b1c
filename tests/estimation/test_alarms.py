"""Alarms: the support by a formula and by hand, thresholds by counting, files that can't be relied on."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clothkit.estimation.agreement import Agreement, AgreementConfig
from clothkit.estimation.alarms import Alarms, Signs, chosen, load, save
from clothkit.estimation.support import Support, fit, strangeness
from clothkit.runtime.errors import InputError

SUPPORT = Support(np.zeros(3, np.float32), np.eye(3, dtype=np.float32))
CLOTHS = np.float32([[0.7, 0.7, 0.007], [1.4, 1.4, 0.028]])


def test_strangeness_is_mahalanobis_distance_by_the_inverse_covariance() -> None:
    rng = np.random.default_rng(0)
    units = rng.normal(size=(5000, 4)) @ rng.normal(size=(4, 4)) + 3
    found = fit(units)
    asked = rng.normal(size=(7, 4)) * 5
    covariance = np.cov(units.T)
    covariance += 1e-3 * np.trace(covariance) / 4 * np.eye(4)
    away = asked - units.mean(0)
    wanted = np.sqrt(np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance), away) / 4)
    np.testing.assert_allclose(strangeness(asked, found), wanted, rtol=1e-4)
    assert strangeness(units, found).mean() == pytest.approx(1, abs=0.1)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 100), st.sampled_from([0.0, 0.02, 0.1]))
def test_at_most_the_share_of_every_batch_raises_an_alarm(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    known = [
        Signs(Agreement(rng.beta(8, 1 + i, n), rng.beta(5, 2, n)), rng.gamma(4, 1, n)) for i, n in enumerate((200, 333))
    ]
    found = chosen(known, SUPPORT, CLOTHS, share=share)
    rates = [found.raised(signs).mean() for signs in known]
    assert max(rates) <= share
    # No threshold is laxer than it must be: what is worse in all three than any known state is noticed.
    worst = [min(signs.agreement[i].min() for signs in known) for i in range(2)]
    strangest = max(signs.strangeness.max() for signs in known)
    outside = Signs(Agreement(*(np.array([value - 0.02]) for value in worst)), np.array([strangest + 0.01]))
    assert found.raised(outside).all()


def test_each_sign_raises_an_alarm_by_itself() -> None:
    alarms = Alarms(AgreementConfig(silhouette=0.8, heights=0.6), 2.0, SUPPORT, CLOTHS)
    signs = Signs(Agreement(np.array([0.9, 0.7, 0.9, 0.9]), np.array([0.7, 0.7, 0.5, 0.7])), np.array([1, 1, 1, 2.1]))
    np.testing.assert_array_equal(alarms.raised(signs), [False, True, True, True])


def test_known_cloths_are_those_within_a_margin() -> None:
    alarms = Alarms(AgreementConfig(), 2.0, SUPPORT, CLOTHS)
    cloths = np.array(
        [[1.4, 1.4, 0.014], [0.7, 1.4, 0.014], [1.4, 0.4, 0.014], [1.4, 1.4, 0.05], [1.4, 1.4, 0.04], [1.4, 1.4, 0.003]]
    )
    np.testing.assert_array_equal(alarms.knows(cloths), [True, True, False, False, True, False])


def test_narrow_cloths_are_known_up_to_a_smaller_thickness() -> None:
    alarms = Alarms(AgreementConfig(), 2.0, SUPPORT, CLOTHS)
    # At 1.4 : 0.78, vertices are 0.78 / 31 apart, which allows two thirds of it: 0.0168. The margin makes it 0.0252.
    cloths = np.array([[1.4, 0.78, 0.025], [0.78, 1.4, 0.026], [1.4, 1.4, 0.026]])
    np.testing.assert_array_equal(alarms.knows(cloths), [True, False, True])
    np.testing.assert_allclose(alarms.thickest(cloths), [0.0252, 0.0252, 0.042], atol=5e-5)


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    support = fit(np.random.default_rng(1).normal(size=(9, 3)))
    alarms = Alarms(AgreementConfig(silhouette=0.8, heights=0.6), 2.5, support, CLOTHS)
    for name in "ab":
        save(tmp_path / name, alarms)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    found = load(tmp_path / "a", units=3)
    assert found[:2] == alarms[:2]
    for one, other in zip((*found.support, found.cloths), (*alarms.support, CLOTHS), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mean": np.zeros(4, np.float32)}, "expected alarms for a net of 3 units, found those of 4"),
        ({"thresholds": np.array([0.5, 0.5, np.nan])}, "expected finite numbers, found NaN"),
        ({"thresholds": np.array([1.5, 0.5, 2.0])}, "expected thresholds from 0 to 1"),
        ({"thresholds": None}, "found a truncated or damaged file"),
    ],
)
def test_damaged_files_are_told(tmp_path: Path, change: dict, message: str) -> None:
    parts = {"thresholds": np.array([0.5, 0.5, 2.0]), "cloths": CLOTHS, **SUPPORT._asdict(), **change}
    np.savez(tmp_path / "alarms.npz", **{name: part for name, part in parts.items() if part is not None})
    with pytest.raises(InputError, match=message):
        load(tmp_path / "alarms.npz", units=3)


def test_a_truncated_file_is_told(tmp_path: Path) -> None:
    save(tmp_path / "whole.npz", Alarms(AgreementConfig(), 2.0, SUPPORT, CLOTHS))
    (tmp_path / "part.npz").write_bytes((tmp_path / "whole.npz").read_bytes()[:100])
    with pytest.raises(InputError, match="truncated or damaged"):
        load(tmp_path / "part.npz", units=3)
