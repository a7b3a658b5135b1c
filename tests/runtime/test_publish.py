"""Outputs are replaced as a whole, on any file systems, through kills at any moment, and when the disk is full."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from clothkit.runtime.errors import InputError
from clothkit.runtime.publish import ARRIVING, REPLACED, leftovers, publish, recover, unfinished_files
from tests.killed import name_of, write

ROOT = Path(__file__).parents[2]
SHARED_MEMORY = Path("/dev/shm")


def run_program(*command: object) -> subprocess.CompletedProcess[str]:
    """A program that finds this checkout."""
    environment = {**os.environ, "PYTHONPATH": f"{ROOT / 'src'}{os.pathsep}{ROOT}"}
    words = [str(word) for word in command]
    return subprocess.run(words, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(params=["one file system", "two file systems"])
def data(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Where outputs lie: beside the work, or on another file system."""
    if request.param == "one file system":
        (tmp_path / "data").mkdir()
        return tmp_path / "data"
    if not SHARED_MEMORY.is_dir() or SHARED_MEMORY.stat().st_dev == tmp_path.stat().st_dev:
        pytest.skip("there is one file system")
    folder = request.getfixturevalue("other_file_system")
    assert isinstance(folder, Path)
    return folder


@pytest.fixture
def other_file_system() -> Iterator[Path]:
    """A folder on it."""
    with tempfile.TemporaryDirectory(dir=SHARED_MEMORY, prefix="clothkit-tests-") as folder:
        yield Path(folder)


@pytest.mark.parametrize(
    ("old", "new"), [("nothing", "new folder"), ("old folder", "new folder"), ("old file", "new file")]
)
def test_outputs_come_to_their_places(tmp_path: Path, data: Path, old: str, new: str) -> None:
    write(tmp_path / "work", new)
    write(data / "deep/out", old)
    publish(tmp_path / "work", data / "deep/out")
    assert name_of(data / "deep/out") == new
    assert [path.name for path in (data / "deep").iterdir()] == ["out"]
    assert not (tmp_path / "work").exists()


@pytest.mark.parametrize(
    ("data", "how"),
    [("one file system", "die"), ("two file systems", "die"), ("two file systems", "fail")],
    indirect=["data"],
)
def test_a_kill_or_a_full_disk_at_any_file_event_leaves_the_old_or_the_new(
    tmp_path: Path, data: Path, how: str
) -> None:
    (tmp_path / "work").mkdir()
    ended = run_program(sys.executable, ROOT / "tests/killed.py", tmp_path / "work", data, how)
    assert ended.returncode == 0, ended.stderr
    assert int(ended.stdout) > 80


def test_what_a_link_leads_to_is_left_alone(tmp_path: Path, data: Path) -> None:
    write(tmp_path / "cached", "old folder")
    (data / "out").symlink_to(tmp_path / "cached")
    write(tmp_path / "work", "new folder")
    publish(tmp_path / "work", data / "out")
    assert not (data / "out").is_symlink()
    assert name_of(data / "out") == "new folder"
    assert name_of(tmp_path / "cached") == "old folder"


def test_leftovers_are_found_and_mended(tmp_path: Path) -> None:
    write(tmp_path / f"a/.set_aside{REPLACED}", "old folder")
    write(tmp_path / f"a/.set_aside{ARRIVING}", "new file")
    write(tmp_path / "b/done", "new folder")
    write(tmp_path / f"b/.done{REPLACED}", "old file")
    found = leftovers([tmp_path, tmp_path / "none"])
    assert found == [tmp_path / "a/set_aside", tmp_path / "b/done"]
    for target in found:
        recover(target)
    assert name_of(tmp_path / "a/set_aside") == "old folder"
    assert name_of(tmp_path / "b/done") == "new folder"
    assert not leftovers([tmp_path])
    assert sorted(path.name for path in tmp_path.glob("*/*")) == ["done", "set_aside"]


IN_A_SMALL_FILE_SYSTEM = """
import subprocess, sys
from pathlib import Path
from clothkit.runtime.errors import InputError
from clothkit.runtime.publish import publish
from tests.killed import name_of, write
work, data = Path(sys.argv[1]), Path(sys.argv[2])
write(data / "out", "old folder")
write(work, "new folder")
(data / "filler").write_bytes(bytes(4096 * int(sys.argv[3])))
if sys.argv[3] == "0":
    subprocess.run(["mount", "-o", "remount,ro", data], check=True)
try:
    publish(work, data / "out")
except InputError as error:
    print(error)
assert name_of(data / "out") == "old folder" and name_of(work) == "new folder"
assert sorted(path.name for path in data.iterdir()) == ["filler", "out"]
subprocess.run(["mount", "-o", "remount,rw", data], check=True)
(data / "filler").unlink()
publish(work, data / "out")
assert name_of(data / "out") == "new folder" and not work.exists()
"""


@pytest.mark.parametrize(("filled", "says"), [(11, "no space is left"), (0, "its file system is read-only")])
def test_on_a_real_disk_that_is_full_or_read_only(tmp_path: Path, filled: int, says: str) -> None:
    (tmp_path / "data").mkdir()
    mount = 'mount -t tmpfs -o size=64k,nr_inodes=99 none "$1" || exit 77; shift; exec "$@"'
    script = (sys.executable, "-c", IN_A_SMALL_FILE_SYSTEM, tmp_path / "work", tmp_path / "data", filled)
    try:
        ended = run_program("unshare", "-rm", "sh", "-c", mount, "sh", tmp_path / "data", *script)
    except FileNotFoundError:
        pytest.skip("there is no unshare")
    if ended.returncode == 77 or "unshare" in ended.stderr:
        pytest.skip("nothing may be mounted here")
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.startswith(f"{tmp_path / 'data/out'}: can't be written: {says}")


def test_a_target_under_a_file_is_told(tmp_path: Path) -> None:
    write(tmp_path / "work", "new file")
    (tmp_path / "data").write_bytes(b"")
    with pytest.raises(InputError, match=r"data: can't be written: something of that name is there already"):
        publish(tmp_path / "work", tmp_path / "data/out")
    assert name_of(tmp_path / "work") == "new file"


def write_into(folder: Path, content: str, error: BaseException | None = None) -> None:
    """A file of that content, and an error after it."""
    with unfinished_files(folder) as part:
        (part / "a").write_text(content)
        assert [path.name for path in folder.iterdir() if not path.name.startswith(".")] == (
            ["a"] if content == "another" else []
        )
        if error:
            raise error


def test_files_come_into_a_folder_once_all_of_them_are_written(tmp_path: Path) -> None:
    folder = tmp_path / "new/folder"
    write_into(folder, "a")
    with pytest.raises(KeyError):
        write_into(folder, "another", KeyError())
    assert [path.name for path in folder.iterdir()] == ["a"]
    assert (folder / "a").read_text() == "a"
    write_into(folder, "another")
    assert [path.name for path in folder.iterdir()] == ["a"]
    assert (folder / "a").read_text() == "another"


@pytest.mark.parametrize("error", [KeyError("x"), InputError("x"), KeyboardInterrupt()])
def test_no_folder_is_left_of_files_that_were_not_written(tmp_path: Path, error: BaseException) -> None:
    with pytest.raises(type(error)):
        write_into(tmp_path / "new/folder", "a", error)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("name", "says"), [("file/new", "a part of its path is a file"), ("x" * 300, "too long")])
def test_a_folder_that_can_not_be_made_is_told(tmp_path: Path, name: str, says: str) -> None:
    (tmp_path / "file").write_text("old")
    with pytest.raises(InputError, match=says):
        write_into(tmp_path / name, "a")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
