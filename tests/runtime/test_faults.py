"""Faults around a stage: a worker that is killed, two runs at once, a clock that jumps, a cache on another file system.

Each ends in one sentence or in nothing at all, and no finished piece is lost.
"""

import ast
import dataclasses
import fcntl
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from dvc.exceptions import DvcException
from dvc.repo import Repo
from tqdm import tqdm

import clothkit.runtime.stage
from clothkit.runtime.errors import InputError
from clothkit.runtime.resumable import resumable_map
from clothkit.runtime.stage import WORK, Stage, stage
from clothkit.simulation.processes import open_pool
from clothkit.simulation.settings import INDIFFERENT, SimulateConfig
from tests.killed_pieces import KEYS, STORAGES, leaving
from tests.runtime.test_publish import SHARED_MEMORY, other_file_system
from tests.runtime.test_stage import here
from tests.tiny import ROOT

__all__ = ["here", "other_file_system"]

TOY = """
import sys
from pathlib import Path
from clothkit.runtime.publish import alone, publish

given, work = Path("given.txt").read_text(), Path(".work")
(work / "folder").mkdir(parents=True, exist_ok=True)
for name in ("folder/part", "file"):
    (work / name).write_text(f"{name} of {given}")
with alone(work / "publishing.lock"):
    for name in ("folder", "file"):
        publish(work / name, Path("data") / name)
"""
"""A stage that publishes a folder and a file."""


def outputs(folder: Path) -> dict[str, str]:
    files = [path for path in sorted((folder / "data").rglob("*")) if path.is_file() and path.name != ".gitignore"]
    return {str(path.relative_to(folder / "data")): path.read_text() for path in files}


def mapped(work: Path, compute: Callable[[str], str], pool: Any = None) -> list[str]:
    with tqdm(disable=True) as bar:
        given: Any = {"storage": STORAGES["file"], "bar": bar, "count": len, "pool": pool, "ahead": lambda: len(KEYS)}
        return [piece.value for piece in resumable_map(compute, KEYS, folder=work / "pieces", name="p", **given)]


def test_a_killed_worker_is_told_in_one_sentence_and_its_run_goes_on(here: Path) -> None:
    """As the system does when memory runs out. Only pieces that were not finished are asked for again."""

    def run() -> None:
        with stage("regularise") as s:
            work = s.work(inputs=[])
            with open_pool("processes", workers=1) as pool:
                found = mapped(work, partial(leaving, place=str(here)), pool)
            (work / "out").write_text("\n".join(found))
            s.publish(work / "out", "data/out")

    with pytest.raises(SystemExit) as ended:
        run()
    sentence = str(ended.value.code)
    assert sentence.startswith("regularise: a worker process ended abruptly (was it killed, or memory short?); free")
    assert "\n" not in sentence
    stored = len(list(WORK.glob("regularise/*/pieces/p_*.txt")))
    (here / "asked").unlink()
    run()
    assert (here / "asked").read_text().split() == list(KEYS)[stored:]
    assert Path("data/out").read_text().splitlines() == [f"piece {key}" for key in KEYS]


def test_work_goes_on_when_another_executor_takes_over(here: Path) -> None:
    """A scheduler that is back at another address, fewer workers: what was stored still counts; other seeds do not."""
    params = json.loads(Path("params.yaml").read_text())
    simulate = params["scales"]["smoke"]["simulate"]

    def place(**changes: Any) -> Path:
        simulate.update(changes)
        Path("params.yaml").write_text(json.dumps(params))
        run = Stage("simulate", None)
        try:
            return run.work(inputs=[])
        finally:
            run.release()

    first = place()
    (first / "piece").touch()
    assert place(executor="dask") == first
    assert place(scheduler="tcp://head:8786") == first
    assert place(scheduler="tcp://head:9999", workers=3, block=7) == first
    assert place(seed=5) != first
    assert (first / "piece").exists()


def test_settings_that_decide_are_all_but_the_indifferent_ones() -> None:
    one = SimulateConfig(sequences=5, seed=3)
    other = dataclasses.replace(one, block=9, workers=7, executor="dask", scheduler="tcp://head:8786")
    assert {name for name in vars(one) if getattr(one, name) != getattr(other, name)} == set(INDIFFERENT)
    assert repr(other.decisive) == repr(one.decisive) == repr(one)
    assert repr(dataclasses.replace(one, seed=4).decisive) != repr(one.decisive)


@pytest.mark.parametrize("name", ["probe", "calibrate", "plan", "evaluate_camera", "evaluate_goals"])
def test_pieces_of_stages_depend_on_no_executor(name: str) -> None:
    """What their names are made of holds `simulate` in no other form than that of `decisive`, or its parts."""
    calls = [
        node
        for node in ast.walk(ast.parse((ROOT / f"stages/{name}.py").read_text()))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "s.pieces"
    ]
    (arguments,) = [[ast.unparse(each) for each in call.args] for call in calls]
    assert [each for each in arguments if each in ("simulate.decisive", "simulate.simulation")]
    assert not [each for each in arguments if each.split(".")[-1] in ("simulate", "stages", *INDIFFERENT)]


def test_of_two_runs_at_once_the_second_is_refused(here: Path) -> None:
    """In one sentence, and the first one ends as if there had been no other."""
    with stage("regularise") as first:
        work = first.work(inputs=[])
        (work / "piece").write_text("first")
        with pytest.raises(SystemExit) as ended, stage("regularise") as second:
            second.work(inputs=[])
        sentence = f"regularise: {work}: another run of stage regularise is at work here; wait for it"
        assert ended.value.code == sentence
        first.publish(work / "piece", "data/out")
    assert Path("data/out").read_text() == "first"
    assert not list((WORK / "regularise").iterdir())


def test_a_run_that_begins_as_another_one_ends_has_a_lock_that_others_find(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other run deletes folder and lock after this one has opened the lock, and before it has locked it."""
    ending, beginning, third = (Stage("regularise", None) for _ in range(3))
    work = ending.work(inputs=[])
    real, calls = fcntl.flock, []

    def flock(file: Any, how: int) -> None:
        if not calls:
            ending.close(time.monotonic())
            ending.release()
        calls.append(how)
        real(file, how)

    monkeypatch.setattr(clothkit.runtime.stage.fcntl, "flock", flock)
    assert beginning.work(inputs=[]) == work
    assert len(calls) == 2
    assert work.is_dir()
    with pytest.raises(InputError, match="another run of stage regularise is at work here"):
        third.work(inputs=[])
    beginning.release()


@pytest.fixture(params=[-(10**9), 10**9], ids=["back", "ahead"])
def jumped(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], None]:
    """A function that moves the clock by thirty years, and all files of a folder by thirty the other way."""

    def jump(folder: Path) -> None:
        now = time.time()
        for path in folder.rglob("*"):
            os.utime(path, (now - request.param, now - request.param))
        monkeypatch.setattr(time, "time", lambda: now + request.param)
        monkeypatch.setattr(time, "time_ns", lambda: int((now + request.param) * 1e9))

    return jump


def test_a_clock_that_jumps_changes_nothing(here: Path, jumped: Callable[[Path], None]) -> None:
    Path("given.txt").write_text("given")
    asked: list[str] = []

    def run(*, stop: str = "") -> None:
        def compute(key: str) -> str:
            if key == stop:
                raise InputError("stopped")
            asked.append(key)
            return f"piece {key}"

        with stage("regularise") as s:
            work = s.work(inputs=[Path("given.txt")])
            found = mapped(work, compute)
            if stop == "end":
                jumped(here)
            (work / "out").write_text("\n".join(found))
            s.publish(work / "out", "data/out")

    with pytest.raises(SystemExit, match="stopped"):
        run(stop=KEYS[1])
    jumped(here)
    run()
    assert asked == list(KEYS)
    assert Path("data/out").read_text().splitlines() == [f"piece {key}" for key in KEYS]
    # Also while it runs, and over an output that seems to be newer, or from long ago.
    run(stop="end")
    assert Path("data/out").read_text().splitlines() == [f"piece {key}" for key in KEYS]
    assert 0 <= json.loads((WORK / "timings/regularise.json").read_text())["seconds"] < 10**6


# Of DVC's own libraries.
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("links", ["copy", "symlink"])
def test_the_cache_may_be_on_another_file_system(tmp_path: Path, request: pytest.FixtureRequest, links: str) -> None:
    """Stages publish over what DVC copied or linked from there, and it takes the new outputs there."""
    if not SHARED_MEMORY.is_dir() or SHARED_MEMORY.stat().st_dev == tmp_path.stat().st_dev:
        pytest.skip("there is one file system")
    cache = request.getfixturevalue("other_file_system")
    (tmp_path / ".dvc").mkdir()
    settings = f"[core]\n    no_scm = true\n    analytics = false\n[cache]\n    dir = {cache}\n    type = {links}\n"
    (tmp_path / ".dvc/config").write_text(settings)
    stages = {"toy": {"cmd": f"{sys.executable} toy.py", "deps": ["given.txt"], "outs": ["data/folder", "data/file"]}}
    (tmp_path / "dvc.yaml").write_text(json.dumps({"stages": stages}))
    (tmp_path / "toy.py").write_text(TOY)
    expected = {name: {"folder/part": f"folder/part of {name}", "file": f"file of {name}"} for name in ("one", "two")}
    with pytest.MonkeyPatch.context() as patch, Repo(str(tmp_path)) as repo:
        patch.setenv("PYTHONPATH", str(ROOT / "src"))
        patch.chdir(tmp_path)
        for given in ("one", "two"):
            (tmp_path / "given.txt").write_text(given)
            assert [done.name for done in repo.reproduce()] == ["toy"]
            assert outputs(tmp_path) == expected[given]
        assert (tmp_path / "data/file").is_symlink() == (links == "symlink")
        # By hand, over what DVC has put there.
        (tmp_path / "given.txt").write_text("one")
        subprocess.run([sys.executable, "toy.py"], cwd=tmp_path, check=True)
        assert outputs(tmp_path) == expected["one"]
        # What the cache has is whole: neither output is made again.
        (tmp_path / "toy.py").unlink()
        for given in ("two", "one"):
            (tmp_path / "given.txt").write_text(given)
            # As after a kill while DVC wrote files of its own, which it does not replace as a whole.
            for own, rest in (("dvc.lock", "schema: '2.0"), (".dvc/tmp/rwlock", "{")):
                (tmp_path / own).write_text(rest)
                with pytest.raises(DvcException):
                    repo.reproduce()
                (tmp_path / own).unlink()
            repo.reproduce()
            assert outputs(tmp_path) == expected[given]
