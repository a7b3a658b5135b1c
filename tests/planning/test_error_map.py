"""The map from signs of doubt to an expected error, fitted to data that follow such a law."""

import json
from pathlib import Path

import numpy as np
import pytest

from clothkit.planning.error_map import ErrorMap, expected_by_others, fit, load, save
from clothkit.runtime.errors import InputError

LEAST = (1e-3, 1e-3, 0.05)
Rows = tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]


def rows(seed: int, count: int = 4000) -> Rows:
    """Rows with error 2 (step + 1) a^0.7 b^0.3 c^0.2, times noise of a known mean."""
    rng = np.random.default_rng(seed)
    ranges = {"a": (0.01, 0.3), "b": (0.01, 0.1), "c": (0, 10)}
    signs = {name: rng.uniform(low, high, count) for name, (low, high) in ranges.items()}
    step = rng.integers(0, 3, count)
    powers = [(signs[name] + b) ** p for name, b, p in zip("abc", LEAST, (0.7, 0.3, 0.2), strict=True)]
    return signs, step, 2 * (step + 1) * np.prod(powers, axis=0) * rng.lognormal(0, 0.4, count)


def fitted(given: Rows) -> ErrorMap:
    signs, step, error = given
    return fit(signs, LEAST, step, error)


def test_the_fit_finds_powers_offsets_and_the_mean() -> None:
    signs, step, error = rows(0)
    found = fitted((signs, step, error))
    np.testing.assert_allclose(found.slope, [0.7, 0.3, 0.2], atol=0.03)
    # The mean of a lognormal factor is exp(sigma^2 / 2).
    np.testing.assert_allclose(np.exp(found.offset), 2 * np.arange(1, 4) * np.exp(0.08), rtol=0.15)
    expected = np.asarray(found(list(signs.values()), step))
    assert (error / expected).mean() == pytest.approx(1, abs=1e-3)


def test_interval_and_share_hold_for_other_rows() -> None:
    found = fitted(rows(0))
    signs, step, error = rows(1)
    expected = np.asarray(found(list(signs.values()), step))
    low, high = found.interval(expected, 0.8)
    assert ((low <= error) & (error <= high)).mean() == pytest.approx(0.8, abs=0.03)
    limit = float(np.median(error))
    for lower, upper in ((0.0, 0.5), (0.5, 0.9)):
        share = found.share_below(limit, expected)
        chosen = (lower < share) & (share <= upper)
        assert (error[chosen] <= limit).mean() == pytest.approx(share[chosen].mean(), abs=0.04)


def test_an_interval_is_as_wide_as_errors_of_that_expectation_scatter() -> None:
    """Errors that are expected to be small scatter by a factor of e, large ones by a tenth of it."""

    def scattered(seed: int, count: int = 6000) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(seed)
        sign = np.exp(rng.uniform(np.log(0.01), np.log(0.3), count))
        wide = np.interp(np.log(sign), np.log([0.01, 0.3]), [1.0, 0.1])
        return sign, sign * np.exp(wide * rng.standard_normal(count))

    sign, error = scattered(0)
    found = fit({"a": sign}, (1e-3,), np.zeros(len(sign), int), error)
    sign, error = scattered(1)
    expected = np.asarray(found([sign], 0))
    low, high = found.interval(expected)
    share = found.share_below(0.05, expected)
    for lower, upper in ((0.01, 0.03), (0.03, 0.1), (0.1, 0.3)):
        chosen = (lower < sign) & (sign < upper)
        inside = ((low <= error) & (error <= high))[chosen].mean()
        assert inside == pytest.approx(0.8, abs=0.08)
        assert share[chosen].mean() == pytest.approx((error[chosen] <= 0.05).mean(), abs=0.04)
    # One interval for all would hold 0.64 of the small ones and 0.97 of the large ones.
    ratio = np.quantile(error / expected, [0.1, 0.9])
    for lower, upper, holds in ((0.01, 0.03, 0.64), (0.1, 0.3, 0.97)):
        inside = ((ratio[0] <= error / expected) & (error / expected <= ratio[1]))[(lower < sign) & (sign < upper)]
        assert inside.mean() == pytest.approx(holds, abs=0.05)


def test_the_interval_of_few_rows_holds_a_further_one() -> None:
    """A further one of n + 1 alike ones is as likely in any of the n + 1 gaps: the interval is not too narrow."""
    inside = []
    for seed in range(300):
        error = np.random.default_rng(seed).lognormal(0, 0.5, 31)
        found = fit({"a": np.ones(30)}, (1e-3,), np.zeros(30, int), error[:30])
        low, high = found.interval(np.asarray(found([np.ones(1)], 0)))
        inside.append(low[0] <= error[30] <= high[0])
    assert np.mean(inside) == pytest.approx(0.8, abs=0.05)


def test_what_is_not_known_stays_so_and_no_rows_are_none() -> None:
    found = fitted(rows(0))
    assert len(found.levels) > 1
    expected = np.array([0.02, np.nan, 0.3])
    for given in (expected, expected[:0], 0.02):
        for told in (*found.interval(given), found.share_below(0.05, given)):
            assert told.shape == np.shape(given)
            np.testing.assert_array_equal(np.isnan(told), np.isnan(given))
    # Alone, a row is told what it is told among others.
    np.testing.assert_array_equal(found.interval(expected)[1][2], found.interval(0.3)[1])


def test_a_file_with_one_list_of_ratios_is_read(tmp_path: Path) -> None:
    found, path = fitted(rows(0, 20)), tmp_path / "map.json"
    save(path, found, {})
    stored = json.loads(path.read_text())
    assert len(stored["ratios"]) == 1
    del stored["levels"]
    path.write_text(json.dumps({**stored, "ratios": stored["ratios"][0]}))
    for expected in (0.01, 0.3):
        np.testing.assert_allclose(load(path, ("a", "b", "c")).interval(expected), found.interval(expected))


def test_an_error_never_falls_where_a_sign_grows() -> None:
    rng = np.random.default_rng(2)
    signs = {name: rng.uniform(0.01, 0.3, 200) for name in "abc"}
    # Errors that fall with every sign: slopes stay at zero.
    found = fit(signs, LEAST, np.zeros(200, int), 0.01 / (signs["a"] * signs["b"] * signs["c"]))
    np.testing.assert_allclose(found.slope, 0, atol=1e-6)


def test_a_row_is_expected_by_the_others() -> None:
    signs, step, error = rows(3, 400)
    sequence = np.repeat(np.arange(40), 10)
    expected = expected_by_others(signs, LEAST, step, error, sequence)
    # A sequence whose errors are a hundred times larger changes nothing of what is expected of itself.
    larger = np.where(sequence == 7, 100 * error, error)
    own = expected_by_others(signs, LEAST, step, larger, sequence)[sequence == 7]
    np.testing.assert_allclose(own, expected[sequence == 7])
    assert np.isnan(expected_by_others(signs, LEAST, step, error, np.zeros(400, int))).all()


def test_steps_without_rows_are_told() -> None:
    with pytest.raises(ValueError, match="step 1"):
        fit({"a": np.ones(4)}, (0.1,), np.array([0, 0, 2, 2]), np.ones(4))


def test_a_map_is_read_as_it_was_written(tmp_path: Path) -> None:
    found, path = fitted(rows(0, 200)), tmp_path / "map.json"
    save(path, found, {"scale": "toy"})
    again = load(path, ("a", "b", "c"))
    signs, step, _ = rows(1, 50)
    np.testing.assert_array_equal(again(list(signs.values()), step), found(list(signs.values()), step))
    np.testing.assert_array_equal(again.ratios, found.ratios)


def test_a_map_of_some_signs_is_told_from_one_of_others(tmp_path: Path) -> None:
    path = tmp_path / "map.json"
    save(path, fitted(rows(0, 200)), {})
    assert load(path, ("z", "a", "b", "c"), some=True).signs == ("a", "b", "c")
    for others in (("a", "b"), ("c", "b", "a")):
        with pytest.raises(InputError, match="found one of a, b, c"):
            load(path, others, some=True)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"signs": ["a", "b"]}, "expected a map of a, b, c, found one of a, b"),
        ({"slope": [1.0, 2.0]}, "a slope and a least value above 0 for each sign"),
        ({"least": [0.0, 1.0, 1.0]}, "a least value above 0"),
        ({"offset": []}, "lists of finite numbers"),
        ({"ratios": ["x"]}, "could not read it"),
        ({"ratios": [[1.0], [2.0]]}, "levels above 0 that rise, and a list of ratios for each"),
        ({"levels": [0.2, 0.1, 0.3]}, "levels above 0 that rise"),
        ({"levels": [0.0, 0.1, 0.3]}, "levels above 0 that rise"),
        ({"offset": None}, "lists of finite numbers|could not read it"),
    ],
)
def test_a_wrong_file_is_told(tmp_path: Path, changed: dict, told: str) -> None:
    path = tmp_path / "map.json"
    save(path, fitted(rows(0, 200)), {})
    path.write_text(json.dumps({**json.loads(path.read_text()), **changed}))
    with pytest.raises(InputError, match=f"map.json: .*({told})"):
        load(path, ("a", "b", "c"))


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"map\.json"):
        load(tmp_path / "map.json", ("a",))
