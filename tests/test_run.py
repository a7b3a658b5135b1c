"""`./run` where people call it from: a checkout that was moved or copied, a link, another folder, a path with spaces.

A script stands in for uv: it notes how it is called and makes a bare environment, so that nothing is installed.
"""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]

UV = f"""#!/bin/sh
echo "$1 $2" >>"${{0%/*}}/calls"
for last; do :; done
case "$1 $2" in
"venv "*)
  rm -rf "$last" && "{sys.executable}" -m venv --without-pip "$last"
  echo "relocatable = true" >>"$last/pyvenv.cfg"
  ;;
"pip install") echo "$last/src" >"$(echo "$last"/.venv/lib/python3.*/site-packages)/_editable_impl_clothkit.pth" ;;
esac
"""

WHERE = "import clothkit, os, sys; print(clothkit.__file__, sys.prefix, os.getcwd(), sep='\\n')"


def checkout(folder: Path) -> Path:
    """What `./run` needs: the script, a lock, a clothkit, and uv."""
    (folder / "src" / "clothkit").mkdir(parents=True)
    (folder / "src" / "clothkit" / "__init__.py").touch()
    shutil.copy(ROOT / "run", folder)
    (folder / "requirements.lock").write_text("numpy==2\n")
    uv = folder / ".uv" / "bin" / "uv"
    uv.parent.mkdir(parents=True)
    uv.write_text(UV)
    uv.chmod(0o755)
    return folder


def call(
    script: Path, *command: str, cwd: Path, status: int = 0, **environment: str
) -> subprocess.CompletedProcess[str]:
    """What `script` does when it is called from `cwd`."""
    clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "LOCK")}
    ended = subprocess.run(
        [script, *command], cwd=cwd, env=clean | environment, capture_output=True, text=True, check=False
    )
    assert ended.returncode == status, ended.stderr
    return ended


def uv_calls(root: Path) -> list[str]:
    """What uv was asked for since the last look."""
    path = root / ".uv" / "bin" / "calls"
    found = path.read_text().splitlines() if path.exists() else []
    path.unlink(missing_ok=True)
    return [line.removesuffix(" -q") for line in found]


def assert_runs(script: Path, root: Path, cwd: Path) -> None:
    """It runs this checkout's clothkit, in its environment, in the caller's folder."""
    file, prefix, folder = call(script, "python", "-c", WHERE, cwd=cwd).stdout.splitlines()
    assert Path(file).resolve() == root.resolve() / "src" / "clothkit" / "__init__.py"
    assert Path(prefix).resolve() == root.resolve() / ".venv"
    assert Path(folder) == cwd.resolve()


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """The caller's folder."""
    (tmp_path / "the caller's").mkdir()
    return tmp_path / "the caller's"


def test_the_first_call_sets_up_and_the_next_does_not(tmp_path: Path, elsewhere: Path) -> None:
    root = checkout(tmp_path / "kit")
    assert_runs(root / "run", root, elsewhere)
    assert uv_calls(root) == ["venv", "pip sync", "pip install"]
    assert_runs(root / "run", root, root)
    assert uv_calls(root) == []
    assert list(elsewhere.iterdir()) == []


@pytest.mark.parametrize("name", ["kit", "a path with spaces", "-dash", "o'clock $HOME *"])
def test_moved_copied_or_linked_it_runs_its_own_code(tmp_path: Path, elsewhere: Path, name: str) -> None:
    root = checkout(tmp_path / "first")
    assert_runs(root / "run", root, elsewhere)
    uv_calls(root)
    shutil.copytree(root, tmp_path / "copies" / name, symlinks=True)
    copy = tmp_path / "copies" / name
    assert_runs(copy / "run", copy, elsewhere)
    moved = (tmp_path / "moved").joinpath(name)
    moved.parent.mkdir()
    root.rename(moved)
    assert_runs(moved / "run", moved, elsewhere)
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "link").symlink_to(moved / "run")
    (tmp_path / "bin" / "second").symlink_to("link")
    assert_runs(tmp_path / "bin" / "second", moved, elsewhere)
    (tmp_path / "folder").symlink_to(moved, target_is_directory=True)
    assert_runs(tmp_path / "folder" / "run", moved, moved)
    assert uv_calls(copy) == uv_calls(moved) == []


def test_a_relative_path_is_the_callers(tmp_path: Path, elsewhere: Path) -> None:
    root = checkout(tmp_path / "kit")
    (elsewhere / "goal.txt").write_text("mine")
    assert call(Path("../kit/run"), "cat", "goal.txt", cwd=elsewhere).stdout == "mine"
    assert call(root / "run", "sh", "-c", "exit 3", cwd=elsewhere, status=3).stdout == ""


def test_another_lock_is_installed_into_the_environment_that_is_there(tmp_path: Path, elsewhere: Path) -> None:
    root = checkout(tmp_path / "kit")
    (root / "requirements-cuda.lock").write_text("numpy==2\njax==1\n")
    call(root / "run", "true", cwd=elsewhere)
    uv_calls(root)
    call(root / "run", "true", cwd=elsewhere, LOCK="requirements-cuda.lock")
    assert uv_calls(root) == ["pip sync", "pip install"]
    ended = call(root / "run", "true", cwd=elsewhere, status=1, LOCK="requirements-rocm.lock")
    assert ended.stderr.startswith(f"run: {root}/requirements-rocm.lock: not found; LOCK names a lock in {root}")


def test_calls_at_once_set_up_one_after_the_other(tmp_path: Path, elsewhere: Path) -> None:
    root = checkout(tmp_path / "kit")
    # What a call that was killed left behind is in nobody's way.
    ended = subprocess.Popen(["true"])
    ended.wait()
    (root / ".setup").symlink_to(str(ended.pid))
    calls = [subprocess.Popen([root / "run", "true"], cwd=elsewhere) for _ in range(3)]
    assert [one.wait(60) for one in calls] == [0, 0, 0]
    assert uv_calls(root) == ["venv", "pip sync", "pip install"]
    assert not (root / ".setup").is_symlink()


@pytest.mark.parametrize("damage", ["can't be moved", "its Python is gone", "half made"])
def test_an_environment_that_cannot_serve_is_made_anew(tmp_path: Path, elsewhere: Path, damage: str) -> None:
    root = checkout(tmp_path / "kit")
    call(root / "run", "true", cwd=elsewhere)
    uv_calls(root)
    venv = root / ".venv"
    if damage == "can't be moved":
        settings = (venv / "pyvenv.cfg").read_text()
        (venv / "pyvenv.cfg").write_text(settings.replace("relocatable = true\n", ""))
    elif damage == "its Python is gone":
        (venv / "bin" / "python").unlink()
        (venv / "bin" / "python").symlink_to(tmp_path / "uninstalled" / "python3")
    else:
        (venv / "installed.lock").unlink()
    assert_runs(root / "run", root, elsewhere)
    assert uv_calls(root) == ["venv", "pip sync", "pip install"]


def test_without_a_supported_python_it_says_so(tmp_path: Path, elsewhere: Path) -> None:
    root = checkout(tmp_path / "kit")
    programs = tmp_path / "programs"
    programs.mkdir()
    for name in ("sh", "dirname", "readlink", "grep", "cmp", "cp", "rm", "ln", "sleep"):
        (programs / name).symlink_to(str(shutil.which(name)))
    (programs / "python3").write_text("#!/bin/sh\nexit 1\n")
    (programs / "python3").chmod(0o755)
    ended = call(root / "run", "true", cwd=elsewhere, status=1, PATH=str(programs))
    assert ended.stderr == "run: found no python3 from 3.11 to 3.13 on PATH; install one\n"
    # A later name on PATH will do.
    (programs / "python3.12").symlink_to(sys.executable)
    call(root / "run", "true", cwd=elsewhere, PATH=f"{programs}{os.pathsep}/usr/bin{os.pathsep}/bin")
    assert uv_calls(root) == ["venv", "pip sync", "pip install"]


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
SUPPORTED = [
    f"3.{minor}" for minor in range(8, 20) if f"3.{minor}.0" in SpecifierSet(PROJECT["project"]["requires-python"])
]


def test_run_takes_the_pythons_that_the_project_supports() -> None:
    script = (ROOT / "run").read_text()
    low, high = re.findall(r"\(3, (\d+)\)", script)
    assert [f"3.{minor}" for minor in range(int(low), int(high) + 1)] == SUPPORTED
    assert {f"python{version}" for version in SUPPORTED} == set(re.findall(r"python3\.\d+", script))


@pytest.mark.parametrize("lock", ["requirements.lock", "requirements-cuda.lock"])
@pytest.mark.parametrize("python", SUPPORTED)
@pytest.mark.parametrize("system", ["linux", "darwin"])
def test_a_lock_serves_every_python(lock: str, python: str, system: str) -> None:
    """One version of each package, and one of everything that the project asks for."""
    environment = {"python_version": python, "python_full_version": f"{python}.0", "sys_platform": system}
    environment |= {"platform_system": system.capitalize(), "os_name": "posix", "platform_machine": "x86_64"}
    lines = [line.rstrip(" \\") for line in (ROOT / lock).read_text().splitlines() if re.match(r"[a-zA-Z0-9]", line)]
    pins = [Requirement(line) for line in lines]
    installed = [pin for pin in pins if pin.marker is None or pin.marker.evaluate(environment)]
    versions = {canonicalize_name(pin.name): next(iter(pin.specifier)).version for pin in installed}
    assert len(versions) == len(installed)
    for text in [*PROJECT["project"]["dependencies"], *PROJECT["dependency-groups"]["dev"]]:
        asked = Requirement(text)
        assert asked.specifier.contains(versions[canonicalize_name(asked.name)]), text
