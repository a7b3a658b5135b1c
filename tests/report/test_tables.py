"""Tables against values computed by hand, their layout, and the paper's figures against its text."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from clothkit.dataset.tables import read
from clothkit.evaluation import planning
from clothkit.evaluation.tidy import PLANNING, PREDICTION
from clothkit.report import paper, planning_tables, tables, timings
from clothkit.report.layout import TASKS
from clothkit.report.markdown import tables as markdown
from clothkit.report.markdown.page import page
from clothkit.runtime.errors import InputError
from tests.evaluation.planning_rows import SYSTEMS, planning_rows
from tests.report.contents import contents_of, dataset, parts_of, tidy_estimates, tidy_tasks


def cell(table: pd.DataFrame, column: str, **keys: str) -> float:
    chosen = table
    for name, value in keys.items():
        chosen = chosen[chosen[name] == value]
    assert len(chosen) == 1
    return float(chosen[column].iloc[0])


def test_prediction_table_takes_the_better_net() -> None:
    found = tables.prediction(tidy_tasks(("main", "a1")), ("main", "a1"))
    own = found[(found["source"] == "clothkit") & (found["statistic"] == "median") & (found["system"] != "no action")]
    assert (own[list(TASKS)] < 0.2).all(axis=None)


def test_voxel_table_has_the_better_net_and_no_action_of_either_truth() -> None:
    systems = ("main", "a1", "a2")
    tidy = tidy_tasks(systems)
    found = tables.prediction_voxels(tidy, systems)
    assert list(found.columns) == ["source", "split", "system", "statistic", *TASKS]
    keys = {"source": "clothkit", "split": "test"}
    chosen = tidy.query("split == 'test' and system == 'a2' and net == '0' and length == 2")
    mean = cell(found, "2/all", system="a2", statistic="mean", **keys)
    assert mean == pytest.approx(chosen["voxel_error"].mean())
    # a2's truth is occluded, so its no action is another one.
    assert cell(found, "3/all", system="no action", statistic="mean", **keys) == pytest.approx(0.05)
    assert cell(found, "3/all", system="no action, occluded", statistic="mean", **keys) == pytest.approx(0.06)
    assert cell(found, "2/all", system="a2", statistic="mean / no action", **keys) == pytest.approx(mean / 0.06)
    assert set(found.loc[found["source"] == "paper", "system"]) == {"main", "a2"}
    assert not found.isna().any(axis=None)


def test_only_voxel_systems_may_lack_a_mesh_error(tmp_path: Path) -> None:
    tidy = tidy_tasks(("main", "a2"))
    path = tmp_path / "prediction.parquet"
    meshless = tidy.assign(error=tidy["error"].where(tidy["system"] == "main"))
    meshless.to_parquet(path)
    assert read(path, PREDICTION)["error"].isna().sum() == len(tidy) / 2
    tidy.assign(error=tidy["error"].where(tidy["system"] == "a2")).to_parquet(path)
    with pytest.raises(InputError, match=r"system, error of split test, .* expected error to be a number"):
        read(path, PREDICTION)
    meshless.assign(voxel_error=tidy["voxel_error"].where(tidy["system"] == "main")).to_parquet(path)
    with pytest.raises(InputError, match="column voxel_error: expected numbers 0 to 1, found nothing"):
        read(path, PREDICTION)


def test_estimation_table() -> None:
    found = tables.estimation(tidy_estimates())
    assert list(found.columns) == ["source", "split", "kind", "statistic", "1", "2", "3", "all"]
    keys = {"source": "clothkit", "split": "test"}
    assert cell(found, "2", kind="dmr", statistic="mean", **keys) == pytest.approx(0.121)
    assert cell(found, "all", kind="pmr", statistic="median", **keys) == pytest.approx(0.021)
    assert cell(found, "3", kind="pmr", statistic="mean / no action", **keys) == pytest.approx(0.031 / 0.25)


def test_position_table() -> None:
    found = tables.position(tidy_tasks(("main", "a1")), ("main", "a1"))
    assert list(found.columns) == ["source", "split", "system", "statistic", "1", "2", "3"]
    assert not found.isna().any(axis=None)
    keys = {"source": "clothkit", "split": "test"}
    # Net a's alone, over sequences 0..3 and every start.
    assert cell(found, "2", system="a1", statistic="mean", **keys) == pytest.approx(0.035)
    by_hand = np.std([0.01 * (sequence + 1) for sequence in range(4)] * 3, ddof=1)
    assert cell(found, "1", system="main", statistic="std", **keys) == pytest.approx(by_hand)
    assert cell(found, "3", system="no action", statistic="median", **keys) == pytest.approx(0.3)
    assert cell(found, "2", system="main", statistic="mean / no action", **keys) == pytest.approx(0.035 / 0.2)
    assert set(found.loc[found["source"] == "paper", "system"]) == {"main", "a1"}


def test_a_missing_system_is_named() -> None:
    with pytest.raises(InputError, match="a1"):
        tables.prediction(tidy_tasks(("main",)), ("main", "a1"))


def test_bad_rows_are_named(tmp_path: Path) -> None:
    path = tmp_path / "main.parquet"
    with pytest.raises(InputError, match=r"main\.parquet"):
        read(path, PLANNING)
    tidy = planning_rows(("main",))
    tidy.drop(columns="start").to_parquet(path)
    with pytest.raises(InputError, match="start"):
        read(path, PLANNING)
    tidy.assign(error=np.nan).to_parquet(path)
    with pytest.raises(InputError, match="error"):
        read(path, PLANNING)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match="can't be read as parquet"):
        read(path, PLANNING)


@pytest.mark.parametrize(
    ("number", "keys", "column", "value"),
    [
        (2, {"split": "test", "kind": "dmr", "statistic": "std"}, "all", 0.0434),
        (2, {"split": "train", "kind": "pmr", "statistic": "median"}, "3", 0.0625),
        (3, {"split": "test", "system": "main", "statistic": "mean"}, "1/2", 0.0914),
        (3, {"split": "train", "system": "a1", "statistic": "median"}, "3/all", 0.0557),
        (5, {"split": "test", "system": "main", "statistic": "mean"}, "3", 0.0505),
        (5, {"split": "test", "system": "a1", "statistic": "std"}, "1", 0.0295),
        (5, {"split": "train", "system": "main", "statistic": "median"}, "2", 0.0189),
        (5, {"split": "train", "system": "a1", "statistic": "mean"}, "1", 0.0164),
        (4, {"split": "test", "system": "main", "statistic": "median"}, "2/1", 0.0131),
        (4, {"split": "test", "system": "a2", "statistic": "mean"}, "1/1", 0.02069),
        (4, {"split": "train", "system": "a2", "statistic": "std"}, "3/all", 0.00544),
        (6, {"split": "test", "system": "main", "statistic": "mean"}, "1/0", 0.0291),
        (6, {"split": "test", "system": "b1", "statistic": "median"}, "1/all", 0.0185),
        (6, {"split": "test", "system": "b3", "statistic": "mean"}, "1/2", 0.0677),
        (6, {"split": "train", "system": "main", "statistic": "std"}, "3/all", 0.0612),
        (6, {"split": "train", "system": "b5", "statistic": "mean"}, "2/all", 0.155),
    ],
)
def test_the_papers_figures(number: int, keys: dict[str, str], column: str, value: float) -> None:
    assert cell(paper.table(number), column, **keys) == value


@pytest.mark.parametrize(("number", "by"), [(2, "kind"), (3, "system"), (4, "system"), (6, "system")])
def test_the_papers_means_fit_together(number: int, by: str) -> None:
    """The paper's "all" is the mean of its columns, as far as its three digits tell: a typing error would show."""
    means = paper.table(number).query("statistic == 'mean'")
    if number == 2:
        assert np.allclose(means[["1", "2", "3"]].mean(axis=1), means["all"], atol=1e-3)
    else:
        assert np.allclose(means[["1/0", "1/1", "1/2"]].mean(axis=1), means["1/all"], atol=1e-3)
        assert np.allclose(means[["2/0", "2/1"]].mean(axis=1), means["2/all"], atol=1e-3)
    assert not means.duplicated(["split", by]).any()


def test_sigma_ratios_are_medians() -> None:
    estimates, tasks = tidy_estimates(), tidy_tasks(("main", "a1"))
    # Ratios have no upper bound: one that is far off moves a mean, and no median.
    for tidy in (estimates, tasks):
        tidy.loc[tidy["sequence"] == tidy["sequence"].max(), "sigma_ratio"] += 100
    found = tables.sigma_ratio(estimates, tasks)
    assert cell(found, "estimate", source="clothkit", split="test") == pytest.approx(0.8)
    assert cell(found, "2", source="clothkit", split="train") == pytest.approx(0.715)


def test_sigma_ratios_of_estimates_are_told_by_state() -> None:
    estimates = tidy_estimates()
    # Three sequences: the median is the second one's. Rows of refined meshes repeat the ratios and do not count.
    estimates["sigma_ratio"] = 0.1 * estimates["state"] + 0.01 * estimates["sequence"]
    estimates.loc[estimates["kind"] == "dmr", "sigma_ratio"] = 9.0
    found = tables.sigma_ratio(estimates, tidy_tasks(("main", "a1")))
    ours = [cell(found, f"estimate {state}", source="clothkit", split="test") for state in (1, 2, 3)]
    assert ours == pytest.approx([0.11, 0.21, 0.31])
    assert cell(found, "estimate", source="clothkit", split="test") == pytest.approx(0.21)
    assert found.loc[found["source"] == "paper", ["estimate 1", "estimate 2", "estimate 3"]].isna().all(axis=None)


def test_what_several_hypotheses_give_is_counted_by_state() -> None:
    states = [(1, 1, 1.0, 0.02, 0.02), (1, 2, 0.6, 0.30, 0.10), (1, 1, 1.0, 0.04, 0.04), (2, 2, 0.8, 0.10, 0.10)]
    rows = pd.DataFrame(states, columns=["state", "hypotheses", "probability", "error", "error_best"])
    rows = rows.assign(split="test", kind="dmr")
    tidy = pd.concat([rows, rows.assign(kind="pmr", error=9.0, error_best=9.0)])
    found = tables.hypotheses(tidy).set_index("state")
    assert found.loc["1", ["states", "several"]].tolist() == pytest.approx([3, 1 / 3])
    assert found.loc["1", ["probability", "error", "best"]].tolist() == pytest.approx([2.6 / 3, 0.12, 0.16 / 3])
    assert found.loc["all", ["states", "several"]].tolist() == [4, 0.5]
    several = ["probability_several", "error_several", "best_several"]
    assert found.loc["all", several].tolist() == pytest.approx([0.7, 0.2, 0.1])
    assert found.loc["3", "states"] == 0
    # No table where there is nothing to choose from, and where older rows do not tell.
    assert tables.hypotheses(tidy.assign(hypotheses=1)).empty
    assert tables.hypotheses(tidy_estimates()).empty


def test_markdown_puts_the_papers_row_below_ours_and_marks_the_better() -> None:
    tidy = planning_rows(("main",), sequences=12)
    table = planning_tables.planning(tidy, planning.intervals(tidy), ("main",))
    ours = table["source"] == "clothkit"
    mean, median = (ours & (table["split"] == "test") & (table["statistic"] == name) for name in ("mean", "median"))
    table.loc[mean & (table["system"] == "main"), list(TASKS)] = [0.02, 0.05, 0.0783, 0.06, 0.07, 0.1, 0.08, 0.2]
    table.loc[median & (table["system"] == "main"), "1/0"] = 0.001
    lines = markdown.paired(table, ["split", "system", "statistic"]).splitlines()
    assert lines[0] == "| split | system | statistic | source | 1/0 | 1/1 | 1/2 | 1/all | 2/0 | 2/1 | 2/all | 3/all |"
    assert lines[2].startswith("| test | main | mean | clothkit | **0.0200** | 0.0500 | 0.0783 | 0.0600 | **0.0700** |")
    assert lines[2].endswith("| 0.100 | **0.0800** | 0.200 |")
    assert lines[3].startswith("| test | main | mean | paper | 0.0291 | **0.0411** | 0.0783 | **0.0495** | 0.0725 |")
    assert lines[3].endswith("| **0.0913** | 0.0819 | **0.109** |")
    # Medians are judged too; spreads, intervals and what has no counterpart are not.
    assert [line for line in lines if "| main | median | clothkit | **0.00100** |" in line]
    assert not [line for line in lines if "**" in line and "| mean |" not in line and "| median |" not in line]


def test_markdown_says_where_sequences_were_too_few() -> None:
    tidy = planning_rows(("main",), sequences=9)
    table = planning_tables.planning(tidy, planning.intervals(tidy), ("main",))
    lines = markdown.paired(table, ["split", "system", "statistic"]).splitlines()
    assert "| test | main | mean 95 % low | clothkit |" + 8 * " too few |" in lines


def test_attempts_are_counted_by_reason() -> None:
    tidy = pd.DataFrame({"accepted": [True, False, True, False], "reason": ["", "strain", "", "height"]})
    found = tables.attempts(tidy)
    assert found.to_dict("list") == {
        "outcome": ["accepted", "height", "strain"],
        "attempts": [2, 1, 1],
        "share": [0.5, 0.25, 0.25],
    }


def test_splits_count_what_was_done() -> None:
    found = tables.splits(dataset())
    assert found.to_dict("list") == {
        "split": ["train", "validation", "test"],
        "sequences": [1, 1, 1],
        "manipulations": [3, 2, 1],
        "single_handed": [pytest.approx(1 / 3), 0.5, 1.0],
    }


def test_timings(tmp_path: Path) -> None:
    note = {"stage": "plan@main", "seconds": 1.5, "cpu_seconds": 2.5, "peak_memory_mib": 900, "machine": "2 x x86_64"}
    (tmp_path / "plan@main.json").write_text(json.dumps(note))
    assert timings.timings(tmp_path).to_dict("records") == [note]
    assert list(timings.timings(tmp_path / "none").columns) == timings.COLUMNS
    (tmp_path / "b.json").write_text("{")
    with pytest.raises(InputError, match=r"b\.json"):
        timings.timings(tmp_path)


def test_the_page_shows_tables_and_figures(tmp_path: Path) -> None:
    shown = contents_of(tmp_path / "report", SYSTEMS, ["sessions_2", "curves"])
    text = page("Report: laptop", parts_of(shown))
    assert "figures/sessions_2.png" in text
    assert "figures/scatter.png" not in text
    # The first thing that is read, below the title.
    assert text.splitlines()[2].startswith("Between plans with the uncertainty term (alpha) and without it")
    assert "| planning | main | paper | **0.0291** |" in text
    assert "| planning | main, labelled | clothkit | 0.1" in text
    assert "| planning | no action | clothkit | 0.355 |" in text
    assert "| test | a1 | mean | paper | 0.0269 | 0.0379 | 0.0506 |" in text
    assert "| Test set | paper | 0.770 | – | – | – | **0.750** | **0.785** |" in text
    assert "| test | b4 † | mean | paper | 0.00768 | 0.0182 |" in text
    assert "| error | main | b5 † | 3/all | 12 |" in text
    assert "| error | b4 | b5 | 3/all | 12 |" in text
    assert "| test | b4 † | all | 72 |" not in text
    assert "| b4 | all | 72 |" in text
    assert "In bold: the better of our figure and the paper's. [CSV](tables/table_7_025.csv)" in text
    assert "](table_8.csv)" in text
    assert "Not measured in this report" not in text


def test_a_page_of_one_planner_compares_nothing(tmp_path: Path) -> None:
    text = page("Report: laptop", parts_of(contents_of(tmp_path / "report", ("main",))))
    assert "tables/planning_comparisons.csv" not in text
    assert "| test | main | mean 95 % low | clothkit |" in text
    assert "| b4 |" not in text.replace("| b4 | paper |", "")
    assert "†" not in text
    assert text.splitlines()[2].startswith(
        "This report planned and executed every task of 12 test and 12 train sequences."
    )
