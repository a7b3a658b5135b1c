"""Tables 6 to 8, intervals and failures against values computed by hand; the paper's figures against its text."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from clothkit.evaluation import planning
from clothkit.report import layout, paper, planning_tables, rows, timings
from clothkit.runtime.errors import InputError
from tests.evaluation.planning_rows import SYSTEMS, planning_rows

TIDY = planning_rows(sequences=12)
INTERVALS = planning.intervals(TIDY)


def cell(table: pd.DataFrame, column: str, **keys: str) -> float:
    chosen = table[(table[list(keys)] == list(keys.values())).all(axis=1)]
    assert len(chosen) == 1
    return float(chosen[column].iloc[0])


@pytest.mark.parametrize("statistic", ["mean", "std", "median"])
@pytest.mark.parametrize("column", layout.TASKS)
def test_planning_tables_against_numpy(column: str, statistic: str) -> None:
    length, start = column.split("/")
    for measure, build in (("error", planning_tables.planning), ("voxel_error", planning_tables.planning_voxels)):
        values = [
            row[measure]
            for row in TIDY.to_dict("records")
            if (row["split"], row["system"], row["length"]) == ("test", "b4", int(length))
            and start in ("all", str(row["start"]))
        ]
        by_hand = {"mean": np.mean(values), "std": np.std(values, ddof=1), "median": np.median(values)}[statistic]
        found = build(TIDY, INTERVALS, SYSTEMS)
        value = cell(found, column, source="clothkit", split="test", system="b4", statistic=statistic)
        assert value == pytest.approx(by_hand)


def test_layout_of_table_6() -> None:
    found = planning_tables.planning(TIDY, INTERVALS, ("main",))
    assert list(found.columns) == ["source", "split", "system", "statistic", *layout.TASKS]
    own = found[found["source"] == "clothkit"]
    assert list(own["split"].unique()) == ["test", "train"]
    statistics = (
        *("mean", "std", "median", "mean 95 % low", "mean 95 % high", "mean, labelled"),
        "mean / no action",
    )
    assert list(zip(own["system"], own["statistic"], strict=True))[:10] == [
        *(("main", statistic) for statistic in statistics),
        *(("no action", statistic) for statistic in ("mean", "std", "median")),
    ]
    assert set(found.loc[found["source"] == "paper", "system"]) == {"main"}
    assert not found.isna().any(axis=None)


def test_intervals_lie_around_our_means() -> None:
    found = planning_tables.planning_voxels(TIDY, INTERVALS, SYSTEMS)
    keys = {"source": "clothkit", "split": "train", "system": "b5"}
    low, mean, high = (
        cell(found, "2/all", **keys, statistic=name) for name in ("mean 95 % low", "mean", "mean 95 % high")
    )
    assert low < mean < high < 0.02
    own = INTERVALS.query("split == 'train' and system == 'b5' and measure == 'voxel_error' and column == '2/all'")
    assert (low, high) == (own["low"].iloc[0], own["high"].iloc[0])
    assert not found[found["source"] == "paper"]["statistic"].str.contains("95").any()


def test_a_system_without_intervals_has_no_rows_of_them() -> None:
    found = planning_tables.planning(TIDY, INTERVALS[INTERVALS["system"] == "main"], ("main", "b1"))
    own = found[(found["source"] == "clothkit") & (found["split"] == "test")]
    assert own.groupby("system")["statistic"].size().to_dict() == {"main": 7, "b1": 5, "no action": 3}
    assert not found.isna().any(axis=None)


def test_no_action_rows_and_ratio() -> None:
    found = planning_tables.planning(TIDY, INTERVALS, SYSTEMS)
    keys = {"source": "clothkit", "split": "train"}
    none = cell(found, "2/all", **keys, system="no action", statistic="mean")
    assert none == pytest.approx(0.2 + 0.055 + 0.2)
    mean = cell(found, "2/all", **keys, system="b1", statistic="mean")
    assert cell(found, "2/all", **keys, system="b1", statistic="mean / no action") == pytest.approx(mean / none)
    voxels = planning_tables.planning_voxels(TIDY, INTERVALS, SYSTEMS)
    assert cell(voxels, "2/all", **keys, system="no action", statistic="mean") == pytest.approx(0.05)
    assert set(voxels.loc[voxels["source"] == "paper", "system"]) == {"main", "b4", "b5"}


def test_a_missing_system_is_named() -> None:
    with pytest.raises(InputError, match="b1"):
        planning_tables.planning(planning_rows(("main",)), INTERVALS, ("main", "b1"))


def test_comparisons_and_failures_are_those_of_the_systems_in_their_order() -> None:
    systems = ("main", "b5", "b4")
    found = planning_tables.comparisons(planning.comparisons(TIDY), systems)
    first = found[(found["split"] == "test") & (found["measure"] == "error")]
    pairs = list(zip(first["system"], first["against"], strict=True))
    assert pairs == [("main", "b5")] * 8 + [("main", "b4")] * 8 + [("b4", "b5")] * 8
    assert list(first["column"])[:8] == list(layout.TASKS)
    failures = planning_tables.failures(planning.failures(TIDY), systems)
    assert list(failures["system"][:12]) == ["main"] * 4 + ["b5"] * 4 + ["b4"] * 4
    assert list(failures["length"][:4]) == ["1", "2", "3", "all"]
    assert planning_tables.comparisons(planning.comparisons(TIDY), ("main",)).empty


def test_the_largest_errors_and_their_causes() -> None:
    found = planning_tables.largest(TIDY, "main", 3)
    assert list(found.columns) == [*planning_tables.LARGEST, "diagnosis"]
    own = TIDY.query("system == 'main' and split == 'test'")
    by_hand = sorted(own["error"], reverse=True)
    assert found["error"].tolist() == by_hand[:3]
    assert len(planning_tables.largest(TIDY, "main", 1000)) == len(own)
    row = found.iloc[1]
    same = own[own["error"] == row["error"]]
    assert (
        same[["sequence", "start", "length", "loss"]].iloc[0].tolist()
        == row[["sequence", "start", "length", "loss"]].tolist()
    )
    assert planning.diagnosis(same).tolist() == [row["diagnosis"]]


@pytest.mark.parametrize(
    ("keys", "column", "value"),
    [
        ({"split": "test", "system": "main", "statistic": "mean"}, "1/0", 0.00282),
        ({"split": "test", "system": "main", "statistic": "std"}, "2/all", 0.00512),
        ({"split": "test", "system": "main", "statistic": "median"}, "1/1", 0.00394),
        ({"split": "test", "system": "b4", "statistic": "mean"}, "2/0", 0.0239),
        ({"split": "test", "system": "b5", "statistic": "median"}, "3/all", 0.0420),
        ({"split": "train", "system": "main", "statistic": "mean"}, "1/2", 0.008302),
        ({"split": "train", "system": "main", "statistic": "median"}, "2/1", 0.0103),
        ({"split": "train", "system": "b4", "statistic": "std"}, "2/0", 0.00984),
        ({"split": "train", "system": "b4", "statistic": "mean"}, "1/all", 0.0175),
        ({"split": "train", "system": "b5", "statistic": "mean"}, "3/all", 0.0424),
    ],
)
def test_the_papers_voxel_figures(keys: dict[str, str], column: str, value: float) -> None:
    assert cell(paper.table(7), column, **keys) == value


def test_the_papers_voxel_means_fit_together() -> None:
    """The paper's "all" is the mean of its columns, as far as its three digits tell: a typing error would show."""
    means = paper.table(7).query("statistic == 'mean'")
    assert len(means) == 6
    assert np.allclose(means[["1/0", "1/1", "1/2"]].mean(axis=1), means["1/all"], atol=1e-4)
    assert np.allclose(means[["2/0", "2/1"]].mean(axis=1), means["2/all"], atol=1e-4)


def write_note(folder: Path, stage: str, **extra: object) -> None:
    note = {"stage": stage, "seconds": 9.0, "cpu_seconds": 9.0, "peak_memory_mib": 9, "machine": "8 x z80 CP/M"}
    (folder / f"{stage}.json").write_text(json.dumps(note | extra))


def test_seconds_per_plan(tmp_path: Path) -> None:
    write_note(tmp_path, "plan@main", plans={"1": [10, 25.0], "2": [4, 18.0], "3": [0, 0.0]}, estimates=[5, 1.0])
    write_note(tmp_path, "plan@b2", plans={"1": [2, 1.0], "2": [2, 3.0], "3": [1, 4.0]})
    write_note(tmp_path, "plan@b1")
    found = timings.table_8(tmp_path, ("main", "b1", "b2", "b4"))
    assert list(found.columns) == ["source", "system", "machine", "1", "2", "3", "estimate"]
    own = found[found["source"] == "clothkit"].set_index("system")
    assert own.loc["main", ["1", "2", "estimate"]].tolist() == [2.5, 4.5, 0.2]
    assert np.isnan(own.loc["main", "3"])
    assert own.loc["b2", ["machine", "1", "2", "3"]].tolist() == ["8 x z80 CP/M", 0.5, 1.5, 4.0]
    # b1's note is of an older run, and b4 was restored from the cache: nothing is known.
    assert own.loc[["b1", "b4"], ["1", "2", "3", "estimate"]].isna().all(axis=None)
    published = found[found["source"] == "paper"]
    assert list(published["system"]) == ["main", "b2", "b4", "main", "main"]
    # Section 6.1: 3.7 ms for VtM, 0.57 s for the refinement.
    assert published["estimate"].iloc[-1] == pytest.approx(0.0037 + 0.57)
    published = published.iloc[:-1]
    assert published[["1", "2", "3"]].to_numpy().tolist() == [
        [4.76, 9.11, 14.7],
        [1.68, 2.98, 4.71],
        [88.3, 192, 335],
        [2.65, 4.44, 6.49],
    ]
    assert published["machine"].iloc[-1] == "JAX / RTX 3090"


def test_without_any_note_the_papers_rows_stand_alone(tmp_path: Path) -> None:
    found = timings.table_8(tmp_path / "none", SYSTEMS)
    assert found.loc[found["source"] == "clothkit", ["1", "2", "3"]].isna().all(axis=None)
    assert found.loc[found["source"] == "paper", "1"].dropna().tolist() == [4.76, 1.68, 88.3, 22.2, 2.65]


@pytest.mark.parametrize(
    ("extra", "sentence"),
    [
        ({"plans": {"2": [1]}}, r"plan@main\.json: plans\.2: expected \[count, seconds\], found \[1\]"),
        ({"plans": [1, 2]}, r"plan@main\.json: plans: expected an object by plan length"),
        ({"estimates": "many"}, r"plan@main\.json: estimates: expected \[count, seconds\]"),
    ],
)
def test_bad_notes_are_named(tmp_path: Path, extra: dict, sentence: str) -> None:
    write_note(tmp_path, "plan@main", **extra)
    with pytest.raises(InputError, match=sentence):
        timings.table_8(tmp_path, ("main",))


def test_a_note_that_leads_nowhere_is_no_note_that_is_missing(tmp_path: Path) -> None:
    (tmp_path / "plan@main.json").symlink_to("nowhere")
    with pytest.raises(InputError, match=r"plan@main\.json: not found"):
        timings.table_8(tmp_path, ("main",))


def test_rows_without_what_failures_are_told_by_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "main.parquet"
    own = TIDY[TIDY["system"] == "main"]
    own.drop(columns="grasp_offered").to_parquet(path)
    with pytest.raises(InputError, match=r"main\.parquet: has no column grasp_offered"):
        rows.read_planning(tmp_path, ("main",))
    own.assign(voxel_error=np.nan).to_parquet(path)
    with pytest.raises(InputError, match=r"main\.parquet: column voxel_error: expected numbers 0 to 1, found nothing"):
        rows.read_planning(tmp_path, ("main",))


def test_rows_of_the_high_viewport_stand_beside_the_others(tmp_path: Path) -> None:
    tall = ["voxel_error_025", "voxel_error_025_no_action"]
    own = TIDY[TIDY["system"] == "main"].reset_index(drop=True)
    own.drop(columns=tall).to_parquet(tmp_path / "main.parquet")
    shuffled = TIDY.sample(frac=1, random_state=0)[["split", "system", "sequence", "start", "length", *tall]]
    shuffled.to_parquet(tmp_path / "voxels_025.parquet")
    found = rows.read_planning(tmp_path, ("main",))
    pd.testing.assert_frame_equal(found[own.columns.tolist()], own)
    shuffled[shuffled["sequence"] > 0].to_parquet(tmp_path / "voxels_025.parquet")
    with pytest.raises(InputError, match=r"voxels_025\.parquet: expected a row for each task"):
        rows.read_planning(tmp_path, ("main",))
    high = planning_tables.planning_voxels(TIDY, INTERVALS, SYSTEMS, measure="voxel_error_025")
    keys = {"source": "clothkit", "split": "test", "system": "b1"}
    own = TIDY.query("split == 'test' and system == 'b1' and length == 2 and start == 1")
    assert cell(high, "2/1", **keys, statistic="median") == pytest.approx(own["voxel_error_025"].median())
    assert cell(high, "3/all", **(keys | {"system": "no action"}), statistic="mean") == pytest.approx(0.05)
    low = INTERVALS.query("split == 'test' and system == 'b1' and measure == 'voxel_error_025' and column == '2/1'")
    assert cell(high, "2/1", **keys, statistic="mean 95 % low") == low["low"].iloc[0]
    assert set(high.loc[high["source"] == "paper", "system"]) == {"main", "b4", "b5"}
