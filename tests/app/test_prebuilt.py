"""Without trained nets, commands use those that come with the repository, and say so."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from clothkit.app.inputs import load_settings
from clothkit.app.plan_file import read_plan
from clothkit.app.prebuilt import load_nets, prebuilt
from clothkit.estimation import alarms
from clothkit.params import load_params
from clothkit.prebuilt import manifest as manifests
from clothkit.prebuilt.files import pack
from clothkit.prebuilt.manifest import manifest_of
from tests.app.conftest import run
from tests.app.plans import finding
from tests.tiny import MEMBERS, alarms_of, write_nets, write_params

FOUND = np.array([[-1, -1, 1, -1, 0.1, 0.7]], np.float32)


def build(root: Path, scale: str, data: Path) -> None:
    folder = root / scale
    pack(data, folder, MEMBERS)
    made = manifest_of(folder, scale=scale, members=MEMBERS, sources={}, params={}, deviations={})
    manifests.write(folder, made)


@pytest.fixture(scope="module")
def nets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("prebuilt")
    write_nets(folder / "data")
    alarms.save(folder / "data/nets/alarms.npz", alarms_of(strangest=1e9))
    for scale in ("household", "laptop"):
        build(folder / "prebuilt", scale, folder / "data")
    return folder


@pytest.fixture
def fresh(nets: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A fresh clone: params, prebuilt nets, and no trained ones."""
    write_params(tmp_path / "params.yaml")
    (tmp_path / "data/nets").mkdir(parents=True)
    (tmp_path / "data/nets/.gitignore").write_text("/pemd\n")
    shutil.copytree(nets / "prebuilt", tmp_path / "prebuilt")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_plan_in_a_fresh_clone(fresh: Path, files: Path) -> None:
    wanted = ("plan", "--state", files / "voxels.npy", "--goal", files / "goal.glb", "--steps", 1)
    with finding(FOUND):
        result = run(*wanted)
    assert result.exit_code == 0, result.output
    assert "notice: no trained nets in data/nets: those of prebuilt/household are used" in result.stderr
    plan = read_plan(fresh / "plan.json")
    assert plan.system == "main"
    assert [made.net for made in plan.steps[0].predictions] == [0, 1]
    # One's own folder is never replaced, and neither are nets that are there.
    result = run(*wanted, "--data", "elsewhere")
    assert result.exit_code == 1
    assert "elsewhere" in result.stderr
    assert "prebuilt" not in result.stderr


def test_settings_are_those_of_the_nets_scale(fresh: Path) -> None:
    folder, settings = load_nets(Path("data"))
    params = load_params(Path("params.yaml"))
    assert params.scale == "smoke"
    assert settings.plan == params.scales["household"].plan
    assert settings.simulation == params.scales["household"].simulate.simulation
    assert settings.data == folder
    assert settings.alarms is not None
    assert folder.is_relative_to(fresh / "cache")


def test_trained_nets_come_first(fresh: Path, nets: Path) -> None:
    shutil.copytree(nets / "data", fresh / "data", dirs_exist_ok=True)
    folder, settings = load_nets(Path("data"))
    assert folder == Path("data")
    assert settings.plan == load_settings(Path("data")).plan == load_params(Path("params.yaml")).stages.plan
    assert not (fresh / "cache").exists()


def test_nets_of_another_scale_tell_of_prebuilt_ones(
    fresh: Path, nets: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(nets / "data", fresh / "data", dirs_exist_ok=True)
    path = fresh / "data/nets/vtm/net.json"
    about = json.loads(path.read_text())
    for scale, told in (("laptop", True), ("household", False)):
        path.write_text(json.dumps({**about, "scale": scale}))
        assert load_nets(Path("data"))[0] == Path("data")
        assert ("of scale laptop; --data prebuilt/household takes" in capsys.readouterr().err) == told
    folder, settings = load_nets(Path("prebuilt/household"))
    assert folder.is_relative_to(fresh / "cache")
    assert settings.plan == load_params(Path("params.yaml")).scales["household"].plan
    assert not capsys.readouterr().err


def test_prebuilt_nets_are_taken_for_a_cloth_that_the_trained_ones_do_not_know(
    fresh: Path, nets: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(nets / "data", fresh / "data", dirs_exist_ok=True)
    # Prebuilt nets know cloths of about 2 mm, these of about 5 mm.
    thick = alarms_of(strangest=1e9)._replace(cloths=np.float32([[1.4, 1.4, 0.0175], [1.4, 1.4, 0.0175]]))
    alarms.save(fresh / "data/nets/alarms.npz", thick)
    towel = {"sides": (0.5, 0.4), "thickness": 0.0025}
    for told in (None, {"side": 0.4, "thickness": 0.005}, {"side": 0.4, "thickness": 0.05}):
        assert load_nets(Path("data"), told)[0] == Path("data")
        assert "are used" not in capsys.readouterr().err
    folder, settings = load_nets(Path("data"), towel)
    assert folder.is_relative_to(fresh / "cache")
    assert settings.plan == load_params(Path("params.yaml")).scales["household"].plan
    told = (
        "the nets in data/nets know no cloth of 0.5 x 0.4 m that is 2.5 mm thick: those of prebuilt/household are used"
    )
    assert told in capsys.readouterr().err
    # The folder that is asked for is taken, whatever its nets know.
    shutil.copytree(fresh / "data", fresh / "mine")
    assert load_nets(Path("mine"), towel)[0] == Path("mine")


def test_nets_of_an_interrupted_chain_are_not_taken(fresh: Path, nets: Path) -> None:
    shutil.copytree(nets / "data/nets/pemd", fresh / "data/nets/pemd")
    assert load_nets(Path("data"))[0].is_relative_to(fresh / "cache")


def test_a_chain_that_stopped_before_its_reference_values_uses_the_prebuilt_nets(
    fresh: Path, nets: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(nets / "data", fresh / "data", dirs_exist_ok=True)
    (fresh / "data/normalisation/mesh.json").unlink()
    assert load_nets(Path("data"))[0].is_relative_to(fresh / "cache")
    told = "notice: the nets in data lack normalisation/mesh.json: those of prebuilt/household are used"
    assert told in capsys.readouterr().err
    # Nets of other members than those that plan are none.
    shutil.copytree(nets / "data/normalisation", fresh / "data/normalisation", dirs_exist_ok=True)
    (fresh / "data/nets/pemd/1").rename(fresh / "data/nets/pemd/7")
    assert load_nets(Path("data"))[0].is_relative_to(fresh / "cache")
    # Without prebuilt nets, what is missing is told when it is needed.
    shutil.rmtree("prebuilt")
    assert load_nets(Path("data"))[0] == Path("data")


def test_which_of_several(fresh: Path) -> None:
    assert prebuilt(Path("prebuilt")) == Path("prebuilt/household")
    shutil.rmtree("prebuilt/household")
    assert prebuilt(Path("prebuilt")) == Path("prebuilt/laptop")
    # A scale that does without them leaves a note.
    shutil.rmtree("prebuilt/laptop")
    Path("prebuilt/laptop").write_text("left out of scale laptop\n")
    assert prebuilt(Path("prebuilt")) is None
    assert load_nets(Path("data"))[0] == Path("data")


def test_truncated_prebuilt_nets_end_a_command_with_one_sentence(fresh: Path, files: Path) -> None:
    path = fresh / "prebuilt/household/nets/vtm/net.npz"
    path.write_bytes(path.read_bytes()[:1000])
    result = run("estimate", files / "voxels.npy")
    assert result.exit_code == 1
    (line,) = result.stderr.strip().splitlines()
    assert "prebuilt/household/nets/vtm/net.npz: expected" in line
    path = fresh / "prebuilt/household/manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "members": []}))
    result = run("estimate", files / "voxels.npy")
    assert result.exit_code == 1
    assert "manifest.json: members" in result.stderr
