"""Comparisons and intervals of planners against NumPy and SciPy, failures and diagnoses by hand."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from clothkit.dataset import tables
from clothkit.dataset.rows import write_rows
from clothkit.evaluation import planning, tidy
from clothkit.evaluation.settings import EvaluatePlanningConfig
from clothkit.runtime.errors import InputError
from tests.evaluation.planning_rows import SYSTEMS, planning_rows


def test_planners_are_compared_in_pairs_by_both_measures() -> None:
    tidy = planning_rows(sequences=12)
    tidy["voxel_error"] += 0.02 * (tidy["system"] == "b5")
    found = planning.comparisons(tidy)
    pairs = {("main", f"b{k}") for k in range(1, 6)} | {("b4", "b5")}
    assert set(zip(found["system"], found["against"], strict=True)) == pairs
    assert len(found) == 6 * 2 * 2 * 8
    means = tidy.query("split == 'train' and length == 2 and start == 1").groupby("system")["voxel_error"].mean()
    keys = {"split": "train", "measure": "voxel_error", "system": "b4", "against": "b5", "column": "2/1"}
    row = found[(found[list(keys)] == list(keys.values())).all(axis=1)].iloc[0]
    assert row["difference"] == pytest.approx(means["b4"] - means["b5"])
    assert row["low"] < row["difference"] < row["high"] < 0
    assert row["p"] < 0.01


def test_one_planner_is_compared_with_none(tmp_path: Path) -> None:
    found = planning.comparisons(planning_rows(("main",)))
    assert found.empty
    write_rows(tmp_path / "comparisons.parquet", found, {})
    pd.testing.assert_frame_equal(
        tables.read(tmp_path / "comparisons.parquet", tidy.ANY_COMPARISONS), found, check_dtype=False
    )


def test_intervals_are_scipys() -> None:
    tidy = planning_rows(("main", "b4"), sequences=40)
    found = planning.intervals(tidy).set_index(["split", "system", "measure", "column"])
    assert len(found) == 2 * 2 * 3 * 8
    values = tidy.query("split == 'test' and system == 'b4' and length == 1 and start == 2")["voxel_error"].to_numpy()
    theirs = stats.bootstrap((values,), np.mean, method="percentile", n_resamples=10_000, rng=np.random.default_rng(1))
    row = found.loc[("test", "b4", "voxel_error", "1/2")]
    assert row["mean"] == pytest.approx(values.mean())
    assert (row["low"], row["high"]) == pytest.approx(tuple(theirs.confidence_interval), abs=1e-4)
    # Over all starts, sequences are drawn, not tasks: an interval of sequence means.
    by_sequence = (
        tidy.query("split == 'train' and system == 'main' and length == 1").groupby("sequence")["error"].mean()
    )
    theirs = stats.bootstrap((by_sequence.to_numpy(),), np.mean, method="percentile", n_resamples=10_000, rng=1)
    row = found.loc[("train", "main", "error", "1/all")]
    assert (row["low"], row["high"]) == pytest.approx(tuple(theirs.confidence_interval), abs=6e-4)
    assert row["sequences"] == 40


def test_intervals_of_what_was_not_measured_are_left_out() -> None:
    tidy = planning_rows(("main",)).drop(columns=["voxel_error_025", "voxel_error_025_no_action"])
    assert set(planning.intervals(tidy)["measure"]) == {"error", "voxel_error"}


def cases() -> pd.DataFrame:
    """Tasks whose shares are easily counted."""
    columns = ["length", "error", "loss", "loss_recorded", "estimate_error", "grasp_offered", "expected"]
    nulls = ["nulls_fired", "nulls_helped"]
    main = [
        (1, 0.10, 1.0, 0.5, 0.01, True, 0.02, 0, 0),  # the search missed what was recorded
        (1, 0.08, 0.5, 1.0, 0.09, False, 0.04, 1, 1),  # rated better than what was recorded, and far off
        (1, 0.02, 0.5, 0.5, 0.05, True, 0.03, 0, 0),  # near
        (2, 0.06, 0.5, 1.0, 0.01, True, 0.07, 2, 1),  # far off again
    ]
    tidy = pd.DataFrame(main, columns=[*columns, *nulls]).assign(
        system="main", layers_reversed=[0.5, 0.2, 0.5, np.nan], estimate_layers_reversed=0.1
    )
    tidy["nulls_last"] = tidy["nulls_fired"]
    voxels = tidy.assign(system="b4", estimate_error=np.nan, estimate_layers_reversed=np.nan, expected=np.nan)
    return pd.concat([tidy, voxels], ignore_index=True).assign(split="test", start=0, sequence=[*range(4)] * 2)


def test_failures_by_hand() -> None:
    found = planning.failures(cases()).set_index(["system", "length"])
    assert set(found["split"]) == {"test"}
    ones = {
        "tasks": 3,
        "search_failure": 1 / 3,
        "model_failure": 1 / 3,
        "layers_reversed": 2 / 3,
        "grasp_offered": 2 / 3,
        "nulls_fired": 1 / 3,
        "nulls_helped": 1,
        "expected": 0.03,
        "error": 0.2 / 3,
        "error_estimate_good": 0.06,
        "error_estimate_bad": 0.08,
    }
    assert found.loc[("main", "1")].drop("split").to_dict() == pytest.approx(ones)
    every = found.loc[("main", "all")]
    assert every[["tasks", "search_failure", "model_failure"]].tolist() == [4, 0.25, 0.5]
    assert every[["nulls_fired", "nulls_helped"]].tolist() == pytest.approx([0.75, 2 / 3])
    assert every["error_estimate_good"] == pytest.approx(0.06)
    assert np.isnan(found.loc[("main", "2"), "error_estimate_bad"])
    # Planners of voxels have no estimate and no expected error in cloth lengths, but all the rest.
    missing = ["expected", "error_estimate_good", "error_estimate_bad"]
    assert found.loc[("b4", "all"), missing].isna().all()
    assert found.loc[("b4", "1")].drop(["split", *missing]).to_dict() == pytest.approx(
        {name: value for name, value in ones.items() if name not in missing}
    )


def test_shares_are_of_what_is_known() -> None:
    tidy = cases().query("system == 'main'")
    tidy = tidy.assign(loss_recorded=tidy["loss_recorded"].where(tidy["sequence"] != 1), nulls_last=0, nulls_helped=0)
    found = planning.failures(tidy).set_index("length")
    assert found.loc["1", ["search_failure", "model_failure"]].tolist() == [0.5, 0]
    assert np.isnan(found.loc["1", "nulls_helped"])


def test_the_first_cause_that_holds_is_named() -> None:
    tidy = cases().query("system == 'main'").reset_index(drop=True).assign(layers_reversed=0.1)
    assert planning.diagnosis(tidy).tolist() == [
        "search failure",
        "grasp point not offered",
        "open",  # near
        "open",  # the nets expected it to be far off
    ]
    offered = tidy.assign(grasp_offered=True)
    assert planning.diagnosis(offered)[1] == "estimate wrong"
    seen = offered.assign(estimate_error=0.01)
    assert planning.diagnosis(seen).tolist() == ["search failure", "model failure", "open", "open"]
    turned = seen.assign(layers_reversed=0.3)
    assert planning.diagnosis(turned).tolist() == ["layers reversed"] * 4
    unseen = turned.assign(estimate_layers_reversed=[0.3, 0.2, np.nan, 0.2])
    assert planning.diagnosis(unseen)[0] == "estimate's layers reversed"


def write_systems(folder: Path) -> pd.DataFrame:
    tidy = planning_rows()
    for system, own in tidy.groupby("system"):
        own.to_parquet(folder / f"{system}.parquet")
    return tidy


def test_rows_of_the_systems_in_params_are_read(tmp_path: Path) -> None:
    tidy = write_systems(tmp_path)
    found = planning.read(tmp_path, EvaluatePlanningConfig(systems=SYSTEMS))
    assert set(found["system"]) == set(SYSTEMS)
    assert len(found) == len(tidy)
    assert set(planning.read(tmp_path, EvaluatePlanningConfig(systems=("b2",)))["system"]) == {"b2"}


def test_bad_files_are_named(tmp_path: Path) -> None:
    write_systems(tmp_path)
    (tmp_path / "b2.parquet").rename(tmp_path / "b3.parquet")
    with pytest.raises(InputError, match=r"b3\.parquet: column system: expected b3 only, found b2"):
        planning.read(tmp_path, EvaluatePlanningConfig(systems=("main", "b3")))
    with pytest.raises(InputError, match=r"b2\.parquet: not found"):
        planning.read(tmp_path, EvaluatePlanningConfig())
    planning_rows(("b2",)).drop(columns="loss_recorded").to_parquet(tmp_path / "b2.parquet")
    with pytest.raises(InputError, match=r"b2\.parquet: has no column loss_recorded"):
        planning.read(tmp_path, EvaluatePlanningConfig())
