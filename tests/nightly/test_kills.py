"""The nightly script itself, with a program in the place of DVC: what counts as a kill, and what it exits with."""

import subprocess
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.nightly import kills

REPRO = """
outs= md5=$(cat md5 2>/dev/null || echo x)
for name in a b c; do
  if ! [ -e $name ]; then
    echo "Running stage '$name':"
    {before}
    touch $name.begun
    sleep 0.1
    touch $name
  fi
  outs="$outs, $name: {{outs: [{{path: $name, md5: $md5}}]}}"
done
echo "stages: {{${{outs#,}}}}" >dvc.lock
"""
"""Three stages, of which those that have ended are not run again."""


@pytest.fixture
def repro(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """The script, with six kills: a function of what its stages do first. Returns what the script exits with."""

    def run(before: str) -> Any:
        class Toy:
            """A checkout."""

            def __init__(self, folder: Path, sources: Path = Path()) -> None:
                self.folder = folder

            def start(self, *command: str) -> "subprocess.Popen[str]":
                program = ["bash", "-c", REPRO.format(before=before)]
                pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
                return subprocess.Popen(program, cwd=self.folder, text=True, start_new_session=True, **pipes)

        monkeypatch.setattr(kills, "Checkout", Toy)
        csv, folder = str(tmp_path / "csv"), str(tmp_path / "checkouts")
        monkeypatch.setattr("sys.argv", ["kills", "6", "--folder", folder, "--csv", csv])
        with pytest.raises(SystemExit) as ended:
            kills.main()
        return ended.value.code

    return run


def test_only_real_kills_count(repro: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert repro("true") == 0
    (row,) = pd.read_csv(tmp_path / "csv/kills.csv").to_dict("records")
    assert (row["kills"], row["outputs"], row["differing"]) == (6, 3, 0)
    said = capsys.readouterr().out
    assert said.count("\nkill ") == 6
    # A chain that has ended is left, and its outputs are compared; the next begins in a checkout of its own.
    assert row["rounds"] == said.count("\nround ") >= 1
    assert len(list((tmp_path / "checkouts").glob("broken_*"))) == 1
    assert said.splitlines()[-1] == f"6 kills in {row['rounds']} rounds: all bytes are equal "


def test_an_output_that_differs_is_told(repro: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """What goes on after a kill gives other outputs here."""
    assert repro("[ -e $name.begun ] && md5=y && echo y >md5") == 1
    assert "outputs differ" in capsys.readouterr().out.splitlines()[-1]


def test_a_run_that_ends_with_an_error_is_no_kill(repro: Any) -> None:
    told = repro("[ -e $name.begun ] && { echo the disk is full; exit 3; }")
    assert told.startswith("dvc repro ended with status 3:")
    assert "the disk is full" in told


TORN = "echo \"'./dvc.lock' is invalid.\"; exit 1"


def test_a_lock_that_a_kill_has_cut_off_is_deleted(repro: Any, tmp_path: Path) -> None:
    once = "[ -e $name.begun ] && ! [ -e torn ] && touch torn dvc.lock"
    assert repro(f"{once}; [ -e torn ] && [ -e dvc.lock ] && {{ {TORN}; }}") == 0
    (row,) = pd.read_csv(tmp_path / "csv/kills.csv").to_dict("records")
    assert row["files of DVC mended"] >= 1


def test_a_lock_that_stays_invalid_is_an_error(repro: Any) -> None:
    assert "is invalid" in repro(f"[ -e $name.begun ] && {{ touch dvc.lock; {TORN}; }}")
