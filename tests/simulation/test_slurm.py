"""The page's recipe for SLURM; programs in the place of `sbatch` and `scancel` run its jobs on this machine."""

import dataclasses
import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from clothkit.params import load_params
from clothkit.simulation.generation import generate
from tests.documents import blocks
from tests.simulation.test_generation import contents
from tests.tiny import ROOT, write_params

pytest.importorskip("dask_jobqueue")

# Closed clusters leave sockets and tasks of their event loops to the garbage collector.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]

SIMULATE: dict[str, Any] = {
    "sequences": 1,
    "seed": 4,
    "block": 1,
    "workers": 1,
    "executor": "dask",
    "simulation": {"side": 16},
    # Folds of so coarse a cloth are bulky and tangled.
    "limits": {"height": 1.0, "intersections": 10**6, "gap": 0.0, "strain_p99": 1.0, "strain_worst": 2.0},
}

SBATCH = """#!/bin/bash
cp "$1" "{folder}/job.sh"  # It is deleted when this program ends.
cd /
env -i HOME="$HOME" PATH=/usr/bin:/bin setsid bash "{folder}/job.sh" >"{folder}/job.log" 2>&1 </dev/null &
echo $! >"{folder}/4711.pid"
echo Submitted batch job 4711
"""
"""A job starts in another folder, with no variables of whoever submitted it."""

SCANCEL = """#!/bin/bash
echo "$1" >>"{folder}/cancelled"
kill -- -$(cat "{folder}/$1.pid")
"""


def write_program(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkout with tiny params, whose PATH has the programs; it is the current folder."""
    folder = tmp_path / "checkout"
    folder.mkdir()
    write_params(folder / "params.yaml")
    params = json.loads((folder / "params.yaml").read_text())
    params["scales"]["smoke"]["simulate"] = SIMULATE
    # As high as the states may be.
    params["scales"]["smoke"]["train_vtm"]["net"]["viewport"] = {"height": SIMULATE["limits"]["height"]}
    (folder / "params.yaml").write_text(json.dumps(params))
    for name in ("src", "stages"):
        (folder / name).symlink_to(ROOT / name)
    write_program(folder / ".venv/bin/python", f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        write_program(tmp_path / "bin" / name, text.format(folder=tmp_path))
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.chdir(folder)
    return folder


def test_the_recipe_records_the_bytes_of_one_machine(
    tmp_path: Path, checkout: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (block,) = (b for b in blocks(ROOT / "docs/gpu-and-cluster.md") if "SLURMCluster" in b.code)
    names: dict[str, Any] = {}
    exec(block.code, names)
    # Without a worker, the stage would wait forever.
    monkeypatch.setattr(subprocess, "run", partial(subprocess.run, timeout=600))
    names["simulate_on_slurm"](1)
    job = (tmp_path / "job.sh").read_text()
    assert "#SBATCH -p normal" in job
    log = (tmp_path / "job.log").read_text()
    assert "Start worker at" in log
    assert (tmp_path / "cancelled").read_text().split() == ["4711"]
    params = load_params(checkout / "params.yaml")
    alone = dataclasses.replace(params.stages.simulate, executor="processes")
    attributes = {"stage": "simulate", "scale": "smoke", "params": params.decisive_section("simulate")}
    generate(tmp_path / "alone", alone, work=tmp_path / "work", attributes=attributes)
    assert contents(checkout / "data/raw") == contents(tmp_path / "alone")
