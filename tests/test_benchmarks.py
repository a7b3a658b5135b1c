"""Arithmetic of benchmarks/paper_hours.py and minutes.py, and what startup.py makes of params.yaml."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from clothkit.params import load_params
from tests.tiny import ROOT

sys.path.append(str(ROOT / "benchmarks"))

import minutes
import paper_hours
import startup


def test_searches_of_a_sequence_are_those_of_its_six_tasks() -> None:
    """Tasks of 1, 1, 1, 2, 2 and 3 manipulations: a session of n searches with n, n - 1, .. 1 of them left."""
    lengths = [1, 1, 1, 2, 2, 3]
    left = [n for length in lengths for n in range(1, length + 1)]
    counted = {n: left.count(n) for n in (1, 2, 3)}
    assert counted == paper_hours.SEARCHES


def test_hours_are_numbers_times_seconds_and_missing_rows_are_empty(tmp_path: Path) -> None:
    for folder, device, milliseconds in (("cpu", "a core", 360.0), ("gpu", "a GPU", 36.0)):
        (tmp_path / folder).mkdir()
        rows = pd.DataFrame({"net": ["pemd"], "device": [device], "step ms": [milliseconds]})
        rows.to_csv(tmp_path / folder / "training.csv", index=False)
    voxels = pd.DataFrame({"system": ["b4"], "strains": [64], "length": [3], "s a plan": [9.0]})
    voxels.to_csv(tmp_path / "cpu/planning_voxels.csv", index=False)
    stages = load_params(ROOT / "params.yaml").scales["paper"]
    found = paper_hours.read([tmp_path / "cpu", tmp_path / "gpu"])
    trained, vtm, _ = (part.row() for part in paper_hours.training(stages, 2, found))
    # 2 nets of 1.6 million iterations of 0.036 s.
    assert trained["hours"] == pytest.approx(2 * 1.6e6 * 0.036 / 3600)
    assert trained["device"] == "a GPU"
    assert vtm["hours"] is None
    plans = {part.name: part.row() for part in paper_hours.planning(stages, found)}
    # 200 sequences, one plan each; 256 strains in place of the row's 64.
    assert plans["plans of 3, b4"]["hours"] == pytest.approx(200 * 9.0 * 4 / 3600)
    assert plans["plans of 3, main"]["hours"] is None


def test_manipulations_are_divided_among_cores() -> None:
    stages = load_params(ROOT / "params.yaml").scales["paper"]
    rows = pd.DataFrame({"step": ["1", "all"], "CPU s each": [9.0, 0.36]})
    one, four = (paper_hours.simulation(stages, rows, cores).row()["hours"] for cores in (1, 4))
    # 3,693 sequences of 3 manipulations, and 7 systems with 10 of each of 200 sequences.
    assert one == pytest.approx((3693 * 3 + 7 * 200 * 10) * 0.36 / 3600, rel=1e-2)
    assert four == pytest.approx(one / 4, rel=1e-2)


def test_minutes_add_up_the_variants_of_a_stage() -> None:
    stages = ["plan@b1", "plan@main", "simulate"]
    before = pd.DataFrame({"stage": stages, "seconds": [60, 120, 600], "cpu_seconds": [120, 180, 900]})
    now = pd.DataFrame({"stage": ["plan@main", "card"], "seconds": [30, 6], "cpu_seconds": [60, 6]})
    rows = {row["stage"]: row for row in minutes.compared(minutes.by_stage(before), minutes.by_stage(now))}
    assert rows["plan"]["wall min before"] == 3
    assert rows["plan"]["CPU min now"] == 1
    assert np.isnan(rows["simulate"]["wall min now"])
    assert rows["all"]["CPU min before"] == 20
    assert list(rows) == ["card", "plan", "simulate", "all"]


def test_a_single_sequence_is_recorded_at_start_up(tmp_path: Path) -> None:
    text = (ROOT / "params.yaml").read_text()
    (tmp_path / "params.yaml").write_text(startup.single(text))
    params = load_params(tmp_path / "params.yaml")
    assert params.scale == "smoke"
    assert params.stages.simulate.sequences == 1
    assert params.scales["laptop"] == load_params(ROOT / "params.yaml").scales["laptop"]


def test_all_that_all_sh_calls_is_there() -> None:
    script = (ROOT / "benchmarks/all.sh").read_text()
    called = re.findall(r"^ *part (\S+)", script, flags=re.MULTILINE)
    assert len(called) > 5
    assert all((ROOT / path).is_file() for path in called)
    subprocess.run(["sh", "-n", ROOT / "benchmarks/all.sh"], check=True)
