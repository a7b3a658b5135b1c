"""Stages publish as a whole, mend what a killed run left, fall back to folders that can be written, and tell errors."""

import errno
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import filelock
import jax
import pytest

import clothkit.runtime.cache
import clothkit.runtime.stage
from clothkit.runtime.cache import drop_unfinished, ensure_jax_cache, writable
from clothkit.runtime.errors import InputError
from clothkit.runtime.stage import WORK, Stage, is_left_out, stage
from tests.killed import name_of, write
from tests.tiny import write_params

ROOT = Path(__file__).parents[2]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkout, as far as stages look at it."""
    write_params(tmp_path / "params.yaml")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        clothkit.runtime.stage, "clothkit", SimpleNamespace(__file__=str(tmp_path / "src/clothkit/__init__.py"))
    )
    return tmp_path


def test_outputs_are_published_and_work_is_dropped(here: Path) -> None:
    write(Path("data/meshes.zarr"), "old folder")
    with stage("regularise") as run:
        work = run.work(inputs=[])
        write(work / "meshes.zarr", "new folder")
        run.publish(work / "meshes.zarr", "data/meshes.zarr")
    assert name_of(Path("data/meshes.zarr")) == "new folder"
    assert not work.exists()
    assert json.loads((WORK / "timings/regularise.json").read_text())["stage"] == "regularise"


def test_what_a_scale_leaves_out_is_a_note_in_its_place(here: Path) -> None:
    folder, file = Path("data/nets/emd_voxel/0"), Path("data/normalisation/voxel.json")
    write(folder, "old folder")
    with stage("train_emd_voxel", "0") as run:
        run.leave_out(folder, file)
    assert folder.read_bytes() == file.read_bytes() == b"left out of scale smoke\n"
    assert is_left_out(folder)
    assert is_left_out(file)
    assert not is_left_out(Path("params.yaml"))
    assert not is_left_out(Path("data"))
    assert not is_left_out(Path("data/nothing"))


def test_what_a_killed_run_set_aside_is_back_before_the_next_begins(here: Path) -> None:
    write(Path("data/raw/.states.replaced"), "old folder")
    write(Path("reports/smoke/.README.md.arriving"), "new file")
    Stage("regularise", None)
    assert name_of(Path("data/raw/states")) == "old folder"
    assert [path.name for path in Path("data/raw").iterdir()] == ["states"]
    assert not list(Path("reports/smoke").iterdir())


@pytest.mark.parametrize("name", [".states.replaced", ".states.arriving", ".net.json.replaced"])
def test_neither_git_nor_dvc_takes_leftovers(name: str) -> None:
    for file in (".gitignore", ".dvcignore"):
        patterns = (ROOT / file).read_text().split()
        assert any(Path(name).match(pattern) for pattern in patterns if pattern.startswith(".*"))


def raising(error: Exception) -> Callable[[], None]:
    """Something that goes wrong."""

    def fail() -> None:
        raise error

    return fail


@pytest.mark.parametrize(
    ("work", "sentence"),
    [
        (lambda: Path("data/none").read_bytes(), "data/none: not found"),
        (lambda: Path(".").read_bytes(), ".: can't be opened: it is a folder, expected a file"),
        (
            lambda: Path("x" * 300).read_bytes(),
            f"{'x' * 300}: can't be opened: its name is too long; choose",
        ),
        (
            raising(PermissionError(errno.EACCES, "", "data/raw")),
            "data/raw: can't be opened: no permission",
        ),
        (raising(OSError(errno.ENOSPC, "")), "a file can't be written: no space is left; free some"),
        (raising(InputError("data/raw: is empty")), "data/raw: is empty"),
    ],
)
def test_what_the_system_says_ends_a_stage_with_one_sentence(
    here: Path, work: Callable[[], object], sentence: str
) -> None:
    write(Path("data/raw"), "old folder")

    def body() -> None:
        with stage("regularise") as run:
            write(run.work(inputs=[]) / "piece", "new file")
            work()

    with pytest.raises(SystemExit) as ended:
        body()
    assert str(ended.value.code).startswith(f"regularise: {sentence}")
    (piece,) = WORK.glob("regularise/*/piece")
    assert name_of(piece) == "new file"
    assert name_of(Path("data/raw")) == "old folder"


@pytest.mark.parametrize(
    "error", [RuntimeError("a fault"), AssertionError(), OSError("a library's"), BrokenPipeError()]
)
def test_faults_of_the_program_keep_their_traceback(here: Path, error: Exception) -> None:
    with pytest.raises(type(error)), stage("regularise"):
        raise error


def test_work_that_can_not_be_made_is_told(here: Path) -> None:
    WORK.write_bytes(b"")
    with pytest.raises(SystemExit) as ended, stage("regularise") as run:
        run.work(inputs=[])
    assert ".work" in str(ended.value.code)


def test_a_cache_that_can_not_be_written_is_replaced_with_a_notice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert writable(tmp_path / "new/cache", "programs") == tmp_path / "new/cache"
    (tmp_path / "file").write_bytes(b"")
    blocked = tmp_path / "file/cache"
    instead = writable(blocked, "programs")
    assert instead is not None
    assert instead.is_dir()
    said = capsys.readouterr().err
    assert said == f"{blocked}: can't be written (Not a directory); programs are kept in {instead} for this run\n"
    given = jax.config.values["jax_compilation_cache_dir"]
    try:
        jax.config.update("jax_compilation_cache_dir", str(blocked))
        ensure_jax_cache(tmp_path / "default")
        assert Path(jax.config.values["jax_compilation_cache_dir"]).is_dir()
        assert "JAX's compiled programs" in capsys.readouterr().err
    finally:
        jax.config.update("jax_compilation_cache_dir", given)


def test_half_written_programs_are_deleted(tmp_path: Path) -> None:
    for name in ("whole-cache", "whole-atime", "torn-cache"):
        (tmp_path / name).write_bytes(b"")
    drop_unfinished(tmp_path)
    assert {path.name for path in tmp_path.glob("*-*")} == {"whole-cache", "whole-atime"}


def test_half_written_programs_stay_where_another_process_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clothkit.runtime.cache, "LOCK_SECONDS", 0.1)
    (tmp_path / "torn-cache").write_bytes(b"")
    with filelock.FileLock(tmp_path / ".lockfile"):
        drop_unfinished(tmp_path)
    assert (tmp_path / "torn-cache").exists()


def test_jax_writes_no_program_without_a_time_of_use(tmp_path: Path) -> None:
    """What `drop_unfinished` takes for half written; JAX does not promise the names of its files."""
    code = (
        "import sys; from pathlib import Path; import jax; from clothkit.runtime.cache import ensure_jax_cache\n"
        "ensure_jax_cache(Path(sys.argv[1])); jax.jit(lambda x: x + 1)(1.0)"
    )
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], env=environment, check=True)
    programs = {path.name.removesuffix("-cache") for path in tmp_path.glob("*-cache")}
    assert programs
    assert programs == {path.name.removesuffix("-atime") for path in tmp_path.glob("*-atime")}


@pytest.mark.parametrize("platform", ["cuda", "nonsense"])
def test_a_device_that_is_not_there_is_told(tmp_path: Path, platform: str) -> None:
    if any(device.platform == "gpu" for device in jax.devices()):
        pytest.skip("it is there")
    write_params(tmp_path / "params.yaml")
    program = (
        "import clothkit, clothkit.runtime.stage, jax.numpy\n"
        "clothkit.__file__ = 'src/clothkit/__init__.py'\n"
        "with clothkit.runtime.stage.stage('regularise'): jax.numpy.zeros(1)"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "JAX_PLATFORMS": platform}
    ended = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 1
    (sentence,) = ended.stderr.splitlines()
    assert sentence.startswith(
        f"regularise: JAX_PLATFORMS: JAX can't use {platform} here; unset it, or set it to cpu ("
    )
