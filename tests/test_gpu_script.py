"""benchmarks/gpu.sh with programs that only pretend: no part ends the others, and each leaves a row."""

import csv
import os
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROGRAMS = {
    "python": 'case $1 in -c) echo Some GPU "$PLATFORM" ;; *training.py) exit 3 ;; *) exit 0 ;; esac',
    "git": 'mkdir -p "$4" && echo "scale: laptop" >"$4/params.yaml"',
    "dvc": 'grep -q "^scale: smoke" params.yaml && [ "$PYTHONPATH" = src ]',
}


def run(folder: Path, platform: str) -> subprocess.CompletedProcess[str]:
    for name, body in PROGRAMS.items():
        program = folder / "programs" / name
        program.parent.mkdir(exist_ok=True)
        program.write_text(f"#!/bin/sh\n{body}\n")
        program.chmod(0o755)
    environment = {**os.environ, "PATH": f"{folder}/programs:{os.environ['PATH']}", "PLATFORM": platform}
    command = [ROOT / "benchmarks/gpu.sh", folder / "rows"]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)


def test_a_part_that_fails_ends_no_other_and_is_told_at_the_end(tmp_path: Path) -> None:
    ended = run(tmp_path, "cuda")
    with (tmp_path / "rows/stages.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["exit status"] for row in rows] == ["3", "0", "0"], ended.stderr
    assert {row["device"] for row in rows} == {"Some GPU cuda"}
    assert sum(int(row["limit s"]) for row in rows) <= 450
    assert ended.returncode == 1


def test_without_a_gpu_nothing_is_measured(tmp_path: Path) -> None:
    ended = run(tmp_path, "cpu")
    assert ended.returncode == 1
    assert "expected a GPU" in ended.stderr
    assert not list((tmp_path / "rows").glob("*"))
