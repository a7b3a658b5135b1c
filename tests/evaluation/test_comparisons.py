"""Paired comparisons against SciPy, and that they tell differences from noise."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from clothkit.dataset import tables
from clothkit.dataset.rows import write_rows
from clothkit.dataset.tasks import TASKS
from clothkit.evaluation import tidy
from clothkit.evaluation.comparisons import COLUMNS, KEYS, compare, interval, of_predictions, sign_flip

ONE_TASK = np.ones(40, int)


def test_the_interval_is_scipys() -> None:
    values = np.random.default_rng(0).normal(0.3, 1, 40)
    found = interval(values, ONE_TASK)
    expected = stats.bootstrap(
        (values,), np.mean, method="percentile", n_resamples=10_000, rng=np.random.default_rng(1)
    )
    assert found == pytest.approx(tuple(expected.confidence_interval), abs=0.02)


def test_the_p_value_is_scipys() -> None:
    values = np.random.default_rng(1).normal(0.3, 1, 40)
    expected = stats.permutation_test(
        (values, np.zeros(40)), lambda a, b: np.mean(a - b), permutation_type="samples", n_resamples=10_000, rng=2
    )
    assert sign_flip(values) == pytest.approx(expected.pvalue, abs=0.02)


def test_p_is_never_zero_and_one_for_no_difference() -> None:
    assert sign_flip(np.ones(40)) == pytest.approx(1 / 10_001)
    assert sign_flip(np.zeros(10)) == 1
    # Two sequences outweigh all others: half of all signs are as far from zero.
    assert sign_flip(np.array([1.0, 1.0, *np.zeros(8)])) == pytest.approx(0.5, abs=0.02)


def test_p_is_uniform_without_a_difference() -> None:
    rng = np.random.default_rng(2)
    found = [sign_flip(rng.normal(size=30), seed=k, draws=500) for k in range(200)]
    assert stats.kstest(found, "uniform").pvalue > 0.01


def of_tasks(total: np.ndarray, count: np.ndarray, axis: int = -1) -> np.ndarray:
    """The mean over tasks of sequences that have several each."""
    return total.sum(axis) / count.sum(axis)


def theirs(total: np.ndarray, count: np.ndarray) -> tuple[float, float]:
    """SciPy's interval of a mean over tasks whose sequences are drawn."""
    draws = {"n_resamples": 10_000, "rng": np.random.default_rng(1)}
    found = stats.bootstrap((total, count), of_tasks, paired=True, vectorized=True, method="percentile", **draws)
    return tuple(found.confidence_interval)


def test_an_interval_over_sequences_weighs_them_by_their_tasks() -> None:
    """Where every sixth sequence has six tasks that are far worse, the mean of sequence means is another."""
    count = np.tile([1, 1, 2, 1, 1, 6], 10)
    means = np.random.default_rng(4).normal(0.1, 0.05, 60) + (count == 6)
    found = interval(means * count, count)
    assert found == pytest.approx(theirs(means * count, count), abs=0.02)
    assert found[0] > means.mean() + 0.1


def test_fewer_than_ten_sequences_have_neither_interval_nor_p() -> None:
    nine, ten = np.linspace(0.1, 0.9, 9), np.linspace(0.1, 1, 10)
    assert np.isnan([*interval(nine, np.ones(9, int)), sign_flip(nine)]).all()
    assert np.isfinite([*interval(ten, np.ones(10, int)), sign_flip(ten)]).all()
    tidy = rows(9)
    found = compare(tidy[tidy["better"]], "voxel_error", "main_occluded", "a2")
    assert found[["low", "high", "p"]].isna().all(axis=None)
    assert np.isfinite(found["difference"]).all()
    assert set(found["sequences"]) == {9}


def rows(sequences: int = 12) -> pd.DataFrame:
    rng = np.random.default_rng(3)
    return pd.DataFrame(
        [
            {
                "split": split,
                "system": system,
                "better": better,
                "sequence": sequence,
                "start": start,
                "length": length,
                "voxel_error": 0.01 + 0.01 * (system == "a2") + (not better) + 0.001 * rng.normal(),
            }
            for split in ("test", "train")
            for system in ("main", "main_occluded", "a2")
            for better in (True, False)
            for sequence in range(sequences)
            for start, length in TASKS
        ]
    )


def test_main_and_a2_are_compared_task_by_task() -> None:
    tidy = rows()
    found = of_predictions(tidy)
    columns = ["1/0", "1/1", "1/2", "1/all", "2/0", "2/1", "2/all", "3/all"]
    assert list(zip(found["split"], found["column"], strict=True)) == [
        (s, c) for s in ("test", "train") for c in columns
    ]
    better = tidy[tidy["better"] & (tidy["split"] == "test") & (tidy["length"] == 2)]
    means = better.groupby("system")["voxel_error"].mean()
    row = found[(found["split"] == "test") & (found["column"] == "2/all")].iloc[0]
    assert row["difference"] == pytest.approx(means["main_occluded"] - means["a2"])
    assert row["low"] < row["difference"] < row["high"] < 0
    assert row["sequences"] == 12
    assert row["p"] < 0.01


def test_tasks_that_one_system_lacks_are_left_out() -> None:
    tidy = rows()
    tidy = tidy[~((tidy["system"] == "a2") & (tidy["sequence"] == 3))]
    found = compare(tidy[tidy["better"]], "voxel_error", "main_occluded", "a2")
    assert set(found["sequences"]) == {11}
    assert np.isfinite(found[["difference", "low", "high", "p"]]).all().all()


def test_sequences_of_unequal_counts_are_compared_task_by_task() -> None:
    """Of every other sequence there is the last start alone, and there the systems differ by more."""
    tidy = rows(40)
    tidy.loc[(tidy["system"] == "a2") & (tidy["sequence"] % 2 == 1), "voxel_error"] += 0.03
    tidy = tidy[(tidy["sequence"] % 2 == 0) | (tidy["start"] + tidy["length"] == 3)]
    found = compare(tidy[tidy["better"]], "voxel_error", "main_occluded", "a2")
    row = found[(found["split"] == "test") & (found["column"] == "1/all")].iloc[0]
    chosen = tidy[tidy["better"] & (tidy["split"] == "test") & (tidy["length"] == 1)]
    task = chosen.set_index(["system", "sequence", "start"])["voxel_error"]
    difference = task["main_occluded"] - task["a2"]
    # Three tasks of each of 20 sequences, one of each of 20 others.
    assert len(difference) == 80
    assert row["difference"] == pytest.approx(difference.mean())
    assert row["difference"] == pytest.approx(-0.01 - 0.03 / 4, abs=0.001)
    by_sequence = difference.groupby("sequence")
    expected = theirs(by_sequence.sum().to_numpy(), by_sequence.count().to_numpy())
    assert (row["low"], row["high"]) == pytest.approx(expected, abs=3e-4)


def test_nothing_to_compare_is_a_table_that_can_be_read(tmp_path: Path) -> None:
    """As at scale household, which has no net that predicts voxels."""
    planned = pd.DataFrame([{"split": "test", "system": "main", **dict.fromkeys(KEYS, 1), "error": 0.1}])
    write_rows(tmp_path / "comparisons.parquet", compare(planned, "error", "main", "a2"), {})
    found = tables.read(tmp_path / "comparisons.parquet", tidy.ANY_COMPARISONS)
    assert found.empty
    assert list(found.columns) == list(COLUMNS)
