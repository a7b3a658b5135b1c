"""Bad input ends a command with one sentence that names the culprit, and leaves what was written as it is."""

import errno
import json
import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import pytest

from clothkit.app import export as app_export
from clothkit.app.inputs import keep_compiled_programs
from clothkit.app.output import write_mesh
from clothkit.cloth.topology import SQUARE
from clothkit.models import store
from tests.app.conftest import run, succeed
from tests.app.plans import changed, content, write

PLAN = ("plan", "--goal", "{files}/goal.glb", "--steps", 1, "--out", "out.json", "--state")
START = "{files}/start.obj"


def raw(name: str, content: bytes | str) -> Callable[[], None]:
    """Makes a file of these bytes."""
    data = content.encode() if isinstance(content, str) else content
    return lambda: Path(name).write_bytes(data) and None  # type: ignore[func-returns-value]


def array(name: str, values: object, **named: object) -> Callable[[], None]:
    """Makes an NPY or NPZ."""
    if named:
        return lambda: np.savez(name, **{key: np.asarray(value) for key, value in named.items()})
    return lambda: np.save(name, np.asarray(values))


def nothing() -> None:
    """Needs no file of its own."""


def quads(scale: float) -> str:
    corners = [(0, 0), (scale, 0), (scale, scale), (0, scale)]
    return "".join(f"v {x} {y} 0\n" for x, y in corners) + "f 1 2 3\nf 1 3 4\n"


def broken_net(name: str, file: str) -> Callable[[], None]:
    """Data of which one file is cut off."""

    def make() -> None:
        shutil.copytree(Path("data").resolve(), "damaged")
        path = Path("damaged") / name / file
        path.write_bytes(path.read_bytes()[:-20])

    return make


def without(name: str) -> Callable[[], None]:
    """Data in which something is missing."""

    def make() -> None:
        shutil.copytree(Path("data").resolve(), "damaged")
        path = Path("damaged") / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()

    return make


def exchanged_net() -> None:
    """Data in which a net lies in another one's place."""
    shutil.copytree(Path("data").resolve(), "damaged")
    shutil.rmtree("damaged/nets/pemd/0")
    shutil.copytree("damaged/nets/vtm", "damaged/nets/pemd/0")
    about = json.loads(Path("damaged/nets/pemd/0/net.json").read_text())
    Path("damaged/nets/pemd/0/net.json").write_text(json.dumps({**about, "validation_score": 0.1}))


def directory(name: str) -> Callable[[], None]:
    """Makes a folder in a file's place."""

    def make() -> None:
        Path(name).unlink(missing_ok=True)
        Path(name).mkdir()

    return make


def link(name: str, to: str) -> Callable[[], None]:
    """Makes a symbolic link in a file's place."""

    def make() -> None:
        Path(name).unlink(missing_ok=True)
        Path(name).symlink_to(to)

    return make


CLOUD = np.random.default_rng(0).uniform(0, 0.4, (2000, 3)) * [1, 1, 0.01]
TABLE = ("--table", 0, 0, 1, 0)
DAMAGED = ("--data", "damaged")

STATES: list[tuple[Callable[[], None], tuple[object, ...], str, str]] = [
    (nothing, ("none.obj",), "none.obj", "not found"),
    (raw("state.stl", "solid"), ("state.stl",), "state.stl", "ending '.stl' is not known"),
    (raw("state.obj", ""), ("state.obj",), "state.obj", "is empty"),
    (raw("state.obj", "v 0 0 0\nv 1 0 0\n"), ("state.obj",), "state.obj", "holds no"),
    (raw("state.glb", b"glTF" + bytes(40)), ("state.glb",), "state.glb", "can't be read as GLB"),
    (raw("state.ply", "ply\nformat ascii 1.0\nelement vertex 9\n"), ("state.ply",), "state.ply", ""),
    (raw("state.obj", quads(400)), ("state.obj",), "state.obj", "spans 400"),
    (raw("state.obj", quads(0.4)), ("state.obj", "--side", -1), "--side: -1", "expected metres above 0"),
    (raw("state.npy", b"\x93NUMPY" + struct.pack("<4H", 1, 9, 9, 9)), ("state.npy",), "state.npy", "broken"),
    (array("state.npy", np.zeros((5, 5))), ("state.npy",), "state.npy", "has shape [5, 5]"),
    (array("state.npy", np.full((32, 32, 3), np.nan)), ("state.npy",), "state.npy", "not finite"),
    (array("state.npy", np.zeros((32, 32, 16))), ("state.npy",), "state.npy", "no occupied voxel"),
    (array("state.npz", None, a=[1], b=[2]), ("state.npz",), "state.npz", "expected one of mesh, voxels, points"),
    (array("state.npy", np.zeros((0, 3))), ("state.npy", *TABLE), "state.npy", "is empty, expected points"),
    (array("state.npy", CLOUD), ("state.npy",), "state.npy", "table not found"),
    (array("state.npy", CLOUD * 1000), ("state.npy", *TABLE), "state.npy", "millimetres"),
    (array("state.npy", CLOUD[:50]), ("state.npy", *TABLE), "state.npy", "50 points are the cloth's"),
    (array("state.npy", CLOUD), ("state.npy", *TABLE, "--box", 5, 5, 5, 6, 6, 6), "state.npy", "box"),
    (array("state.npy", CLOUD), ("state.npy", "--box", 5, 5, 5, 1, 1, 1), "--box", "low corner first"),
    (array("state.npy", CLOUD), ("state.npy", "--box", "nan", 0, 0, 1, 1, 1), "--box", "finite"),
    (array("state.npy", CLOUD), ("state.npy", "--table", 0, 0, 0, 1), "table (0.0, 0.0, 0.0, 1.0)", "expected a, b"),
    (array("state.npy", CLOUD), ("state.npy", "--table-colour", 0, 0, 0, 9, 9, 9), "state.npy", "has no colours"),
    (array("state.npy", CLOUD), ("state.npy", "--mask", "none.npy"), "none.npy", "not found, expected a mask"),
    (array("state.npy", CLOUD), ("state.npy", "--mask", "."), ".: can't be read, expected a mask", "it is a folder"),
    (array("state.npy", CLOUD), ("state.npy", "--mask", "state.npy"), "state.npy", "is no mask of 2000 points"),
    (nothing, (START, "--mask", "mask.npy"), "mask.npy", "is a mask for points"),
    (raw("state.pcd", "VERSION 0.7\nFIELDS a b\n"), ("state.pcd",), "state.pcd", ""),
    (raw("cloth.zarr", "x"), ("cloth.zarr:0/1",), "cloth.zarr", "is a file, expected a zarr store"),
    (nothing, ("{files}/cloud.npz", "--system", "b1"), "cloud.npz", "plans from a mesh"),
    (nothing, (START, "--data", "nowhere"), "nowhere/nets/pemd/0", "not found"),
    (without("nets/vtm"), ("{files}/cloud.npz", *DAMAGED), "damaged/nets/vtm", "not found"),
    (without("normalisation/mesh.json"), (START, *DAMAGED), "normalisation/mesh.json", "not found"),
    (without("nets/pemd/1/net.json"), (START, *DAMAGED), "pemd/1/net.json", "not found, expected a net's description"),
    (broken_net("nets/pemd/0", store.WEIGHTS), (START, *DAMAGED), "pemd/0/net.msgpack", "damaged"),
    (broken_net("nets/pemd/1", store.ATTRIBUTES), (START, *DAMAGED), "pemd/1/net.json", "truncated or damaged file"),
    (nothing, (START, "--reach", 0, 0, 0, -1, -1, -1), "--reach", "low corner first"),
    (nothing, (START, "--after", "out.json"), "out.json", "another file"),
    (link("old.json", "old.json"), (START, "--after", "old.json"), "old.json", "its symbolic links lead in a circle"),
    (nothing, (START, "--out", "nowhere/plan.json"), "nowhere/plan.json", "is no folder"),
    (nothing, (START, "--out", "plan.txt"), "plan.txt", "expected json"),
    (nothing, (START, "--out", f"{'x' * 300}.json"), "xxx.json", "can't be written: its name is too long"),
    (nothing, (START, "--out", "params.yaml/plan.json"), "params.yaml/plan.json", "params.yaml is no folder"),
    (exchanged_net, (START, *DAMAGED), "pemd/0/net.json", "kind: expected 'pemd', found 'vtm'"),
    (directory("params.yaml"), (START,), "params.yaml", "it is a folder, expected a file"),
    (link("params.yaml", "params.yaml"), (START,), "params.yaml", "its symbolic links lead in a circle"),
    (link("params.yaml", "nowhere.yaml"), (START,), "params.yaml", "not found"),
    (raw("params.yaml", "scale: laptop\nalhpa: 1\n"), (START,), "params.yaml", ""),
    (raw("params.yaml", "scale: [\n"), (START,), "params.yaml", "is not valid YAML"),
    (raw("old.json", "{"), (START, "--after", "old.json"), "old.json", "is not valid JSON"),
    (raw("old.json", "{}"), (START, "--after", "old.json"), "old.json", "format: field required"),
    (nothing, (START, "--after", "old.json"), "old.json", "not found, expected a plan"),
]


@pytest.mark.parametrize(("make", "arguments", "culprit", "says"), STATES, ids=range(len(STATES)))
def test_bad_input_is_told_in_one_sentence(
    here: Path, files: Path, make: Callable[[], None], arguments: tuple[object, ...], culprit: str, says: str
) -> None:
    Path("out.json").write_text("of an earlier call")
    make()
    before = {path: path.read_bytes() for path in here.iterdir() if path.is_file()}
    result = run(*(str(argument).format(files=files) for argument in (*PLAN, *arguments)))
    assert result.exit_code == 1, result.output
    assert isinstance(result.exception, SystemExit)
    assert "Traceback" not in result.output
    assert result.stdout == ""
    # Before it there is how long what went well took.
    *done, sentence = result.stderr.splitlines()
    assert all(line.endswith(" s") for line in done)
    assert sentence.startswith("plan: ")
    assert culprit in sentence
    assert says in sentence
    assert sentence.count("plan: ") == 1
    assert {path: path.read_bytes() for path in here.iterdir() if path.is_file()} == before


BAD_PLANS: list[tuple[str, object, str]] = [
    ("format", "something", "format"),
    ("version", 3, "version: input should be 2"),
    ("frame", "robot", "frame"),
    ("side_m", 0, "side_m"),
    ("steps", [], "steps"),
    ("steps.0.manipulation", [1, 2], "steps.0.manipulation"),
    ("steps.0.manipulation.4", "0.5", "steps.0.manipulation.4"),
    ("steps.0.predictions", None, "steps.0.predictions"),
    ("start.state.vertices_m.3", [], "start.state"),
    ("start.state.kind", "cloud", "start.state"),
    ("extra", 1, "extra"),
    ("memory.traces_before", [[[1.0]]], "memory.traces_before"),
    ("memory.traces_before", [[[1.0], [1.0, 2.0]]], "memory.traces_before"),
    ("system", "b9", "b9"),
    ("state", ..., "state: field required"),
]


@pytest.mark.parametrize(("field", "value", "says"), BAD_PLANS)
def test_a_plan_file_that_is_none_is_told(here: Path, files: Path, field: str, value: object, says: str) -> None:
    write(here / "plan.json", changed(content(), field, value))
    result = run("predict", "--state", files / "start.obj", "--plan", "plan.json")
    assert result.exit_code == 1
    *_, sentence = result.stderr.splitlines()
    assert sentence.startswith("predict: ")
    assert says in sentence
    assert field == "system" or "plan.json" in sentence
    assert not Path("predicted").exists()


def test_a_plan_file_with_a_key_twice_is_told(here: Path, files: Path) -> None:
    text = json.dumps(content())
    Path("plan.json").write_text(text.replace('"system": ', '"system": "b1", "system": ', 1))
    result = run("simulate", "--state", files / "start.obj", "--plan", "plan.json")
    assert result.exit_code == 1
    assert result.stderr == 'simulate: plan.json: expected a plan, found key "system" twice\n'


def test_estimate_without_a_name_to_write_is_told(here: Path, files: Path) -> None:
    result = run("estimate", files / "voxels.npy", "--out", "")
    assert result.exit_code == 1
    assert result.stderr == "estimate: .: ending '', expected obj or ply or glb\n"


def test_a_plan_in_another_frame_is_not_simulated(here: Path, files: Path) -> None:
    write(here / "plan.json", content())
    write_mesh(here / "elsewhere.obj", SQUARE.flat().astype(float) * 0.4 / 1.4 + [2, 0, 0])
    result = run("simulate", "--plan", "plan.json", "--state", "elsewhere.obj")
    assert result.exit_code == 1
    assert "plan.json: step 1 grasps" in result.stderr
    assert not Path("mesh.glb").exists()


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        (("plan", "--state", "a.obj"), "--goal"),
        (("plan", "--state", "a.obj", "--goal", "b.obj"), "--steps"),
        (("plan", "--state", "a.obj", "--goal", "b.obj", "--steps", 4), "--steps"),
        (("plan", "--state", "a.obj", "--goal", "b.obj", "--steps", 1, "--system", "b9"), "--system"),
        (("plan", "--state", "a.obj", "--goal", "b.obj", "--steps", 1, "--table", 1), "--table"),
        (("estimate",), "FILE"),
        (("simulate",), "--plan"),
        (("export", "data/raw"), "--all"),
        (("fold",), "fold"),
    ],
)
def test_usage_is_told_with_status_two(here: Path, arguments: tuple[object, ...], culprit: str) -> None:
    result = run(*arguments)
    assert result.exit_code == 2
    assert culprit in result.stderr.splitlines()[-1]


def test_commands_keep_programs_in_a_temporary_folder_where_theirs_can_not_be_written(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = jax.config.values["jax_compilation_cache_dir"]
    try:
        jax.config.update("jax_compilation_cache_dir", str(here / "params.yaml/compiled"))
        keep_compiled_programs()
        assert Path(jax.config.values["jax_compilation_cache_dir"]).is_dir()
    finally:
        jax.config.update("jax_compilation_cache_dir", given)
    assert capsys.readouterr().err.startswith(f"{here / 'params.yaml/compiled'}: can't be written (")


def test_a_name_as_long_as_names_may_be_can_be_written(here: Path, files: Path) -> None:
    name = "m" * 251 + ".obj"
    write_mesh(Path(name), SQUARE.flat().astype(float))
    assert Path(name).is_file()
    assert [path.name for path in here.iterdir() if path.suffix == ".obj"] == [name]


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (
            PermissionError(errno.EACCES, "Permission denied", "data/x"),
            "data/x: can't be opened: no permission",
        ),
        (FileNotFoundError(errno.ENOENT, "No such file", "data/x"), "data/x: not found"),
        (OSError(errno.EXDEV, "Cross-device", "a", None, "data/x"), "data/x: can't be opened: it is on another file"),
        (OSError(errno.ENOSPC, "No space left on device"), "a file can't be written: no space is left; free some"),
    ],
)
def test_what_the_system_says_and_nobody_told_is_told(
    here: Path, monkeypatch: pytest.MonkeyPatch, error: OSError, sentence: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(app_export, "export", fail)
    result = run("export", "data/raw", "--all")
    assert result.exit_code == 1
    assert isinstance(result.exception, SystemExit)
    assert result.stderr.startswith(f"export: {sentence}")
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize("error", [BrokenPipeError(errno.EPIPE, "Broken pipe"), ZeroDivisionError(), RuntimeError("x")])
def test_faults_of_the_program_keep_their_traceback(
    here: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(app_export, "export", fail)
    result = run("export", "data/raw", "--all")
    assert not result.stderr.startswith("export: ")
    assert result.exit_code == 1


def test_other_commands_tell_as_well(here: Path, files: Path) -> None:
    for arguments, says in (
        (("estimate", "none.ply"), "estimate: none.ply: not found"),
        (("estimate", files / "voxels.npy", "--out", "a.stl"), "estimate: a.stl: ending '.stl', expected obj or"),
        (("export", "none", "--all"), "export: none: not found"),
        (("export", "x" * 300, "--all"), f"export: {'x' * 300}: can't be opened: its name is too long"),
        (("export", "data", "--all", "--cloth-side", "nan"), "export: cloth side nan: expected metres, above 0"),
        (("export", "data", "--all", "--cloth-side", "inf"), "export: cloth side inf: expected metres, above 0"),
        (("export", "data", "--all", "--cloth-side", "-0.4"), "export: cloth side -0.4: expected metres, above 0"),
        (("export", "data", "--all", "--cloth-side", "1e300"), "export: cloth side 1e+300: expected metres, above"),
        (("simulate", "--plan", "none.json"), "simulate: none.json: not found, expected a plan"),
    ):
        result = run(*arguments)
        assert result.exit_code == 1
        assert result.stderr.startswith(says)
        assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize("command", ["plan", "estimate", "predict", "simulate", "export"])
def test_help_has_an_example(command: str) -> None:
    said = succeed(command, "--help")
    assert f"clothkit {command} " in said.split("Options:")[0].split("\n\n", 1)[1]
