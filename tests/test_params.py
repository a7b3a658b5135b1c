"""Bad params end in one sentence that names the key. The params are the tests' own: the workspace's may be changed."""

import errno
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from clothkit.estimation.refine import PAPERS
from clothkit.params import load_params
from clothkit.runtime.errors import InputError

ROOT = Path(__file__).parents[1]


def write(folder: Path, **changes: Any) -> Path:
    """The repository's params with dotted keys changed; a value of ... removes the key."""
    params = YAML(typ="safe").load(ROOT / "params.yaml")
    for dotted, value in changes.items():
        *path, last = dotted.split(".")
        section = params
        for key in path:
            section = section.setdefault(key, {})
        if value is ...:
            del section[last]
        else:
            section[last] = value
    YAML().dump(params, folder / "params.yaml")
    return folder / "params.yaml"


def test_every_scale_of_the_repository_is_valid(tmp_path: Path) -> None:
    params = load_params(write(tmp_path))
    assert set(params.scales) == {"smoke", "laptop", "overnight", "paper", "household"}
    assert hash(params.stages.plan) == hash(params.stages.plan)
    assert params.scales["paper"].plan.refine == PAPERS
    assert params.section("regularise")["train"] == params.stages.regularise.train


def test_an_ensemble_is_the_papers_two_nets_unless_told(tmp_path: Path) -> None:
    assert load_params(write(tmp_path)).ensemble.members == (0, 1)
    assert load_params(write(tmp_path, ensemble=...)).ensemble.members == (0, 1)
    assert load_params(write(tmp_path, **{"ensemble.members": [7]})).ensemble.members == (7,)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"scales.laptop.simulate.seqences": 3}, "scales.laptop.simulate.seqences is not a known key"),
        ({"alhpa": 1.0}, "alhpa is not a known key"),
        (
            {"scales.smoke.train_pemd.net.latent": -4},
            "scales.smoke.train_pemd.net.latent: input should be greater than",
        ),
        ({"scales.laptop.regularise.train": "many"}, "scales.laptop.regularise.train: input should be a valid integer"),
        ({"ensemble.members": []}, "ensemble.members: tuple should have at least 1 item"),
        ({"ensemble.members": [0, 1, 0]}, "ensemble: value error, members must differ from one another"),
        ({"ensemble.members": [0, -1]}, "ensemble.members.1: input should be greater than or equal to 0"),
        ({"ensemble.members": [2**32]}, "ensemble.members.0: input should be less than"),
        ({"ensemble.members": 2}, "ensemble.members: input should be a valid"),
        ({"ensemble.nets": [0]}, "ensemble.nets is not a known key"),
        ({"scales.laptop.regularise.train": 3.5}, "scales.laptop.regularise.train: input should be a valid integer"),
        ({"scales.laptop.simulate.source": "arksim"}, "simulate.source: input should be 'own' or 'arcsim', found"),
        ({"alpha": -1.0}, "alpha: input should be greater than or equal to 0"),
        ({"app.side": -0.4}, "app.side: input should be greater than 0, found -0.4"),
        ({"app.reach": {"low": [0.0, 0.0, 0.0]}}, "app.reach.high is missing"),
        ({"scale": "huge"}, "scale: input should be 'smoke', 'laptop', 'overnight', 'paper' or 'household'"),
        ({"scales.paper.regularise": ...}, "scales.paper.regularise is missing"),
        ({"scales.paper.plan.systems": ["b9"]}, "systems has 'b9', expected some of main, b1"),
        ({"scales.paper.plan.systems": ["main"]}, "evaluate_planning.systems has b1, which plan.systems leaves out"),
        ({"scales.paper.train_emd_voxel": None}, "plan.systems has b4, which plans in voxels, but train_emd_voxel is"),
        (
            {"scales.laptop.simulate.limits": {"height": 0.2}},
            "train_vtm.net.viewport.height is 0.125, but simulate.limits.height lets states be 0.2 high",
        ),
        ({"scales.paper.train_vtm": None}, "scales.paper.train_vtm: is empty, expected a value"),
    ],
)
def test_bad_params_are_refused_by_name(tmp_path: Path, changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=re.escape(sentence)):
        load_params(write(tmp_path, **changes))


LAUGHS = "a: &a [1, 2, 3, 4, 5, 6, 7, 8, 9]\n" + "".join(
    f"{chr(c + 1)}: &{chr(c + 1)} [{', '.join([f'*{chr(c)}'] * 9)}]\n" for c in range(ord("a"), ord("n"))
)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("alpha: .nan", "alpha: expected a finite number, found nan"),
        ("app: {side: -.inf}", "app.side: expected a finite number, found -inf"),
        ("alpha: 1e400", "alpha: expected a finite number, found inf"),
        ("alpha: 2026-01-01", "alpha: expected a number, a word, a list or keys, found a date"),
        ("alpha: 2026-01-01 10:00:00", "alpha: expected a number, a word, a list or keys, found a date"),
        ("alpha: 2026-13-01", "line 1, 'alpha: 2026-13-01': this can't be taken as timestamp"),
        ("app: !!set {a, b}", "app: expected a number, a word, a list or keys, found a set"),
        ("app: {name: !!binary aGVsbG8=}", "app.name: expected a number, a word, a list or keys, found a piece of"),
        ("app: !!pairs [a: 1]", "app.0: expected a number, a word, a list or keys, found a pair"),
        ("app: {[1, 2]: 3}", "app: expected words as keys, found (1, 2)"),
        ("{a: 1}: 3", "line 1, '{a: 1}: 3': found unhashable key"),
        ("1: 3", "expected words as keys, found 1"),
        ("~: 3", "expected words as keys, found None"),
        (f"alpha: {'9' * 40}", "alpha: expected an integer between -2^63 and 2^63, found one of 133 bits"),
        (f"alpha: {'9' * 5000}", "line 1, 'alpha: 999"),
        (f"alpha: 0x{'f' * 5000}", "alpha: expected an integer between -2^63 and 2^63, found one of 20000 bits"),
        ("alpha: &a [*a]", "alpha.0.0: expected at most 50 levels, found more (or an alias of itself)"),
        ("alpha: &a {b: *a}", "alpha.b.b: expected at most 50 levels, found more (or an alias of itself)"),
        (LAUGHS, "expected at most 100000 values, aliases written out, found more"),
        (f"alpha: {'[' * 500}", "expected at most 50 levels of nesting, found far more"),
        ("alpha: *nope", "line 1, 'alpha: *nope': found undefined alias 'nope'"),
        ("alpha: 1\nalpha: 2", "line 2, 'alpha: 2': found duplicate key"),
        ("alpha: !!python/object:os.system ls", "could not determine a constructor"),
        ("alpha: \0", "is not valid YAML (unacceptable character"),
        ("alpha: 1\n---\nalpha: 2", "line 2, '---': but found another document"),
        ("app:", "scale is missing"),
        ("- 1", "expected keys (scale, alpha, ..) with their values, found a list"),
        ("word", "expected keys (scale, alpha, ..) with their values, found a single value"),
        ("", "expected keys (scale, alpha, ..) with their values, found nothing"),
        ("# nothing\n", "expected keys (scale, alpha, ..) with their values, found nothing"),
        (b"alpha: caf\xe9", "is not UTF-8 text (from byte 10 on)"),
    ],
)
def test_what_yaml_can_hold_and_params_can_not_is_told(tmp_path: Path, text: str | bytes, sentence: str) -> None:
    path = tmp_path / "params.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as told:
        load_params(path)
    assert str(told.value).startswith(f"{path}: ")
    assert sentence in str(told.value)
    assert len(str(told.value).splitlines()) == 1
    assert len(str(told.value)) < len(str(path)) + 200


@pytest.mark.parametrize("key", ["app", "alpha", "scales.smoke.card", "scales.smoke", "scales"])
def test_a_block_without_anything_in_it_is_told(tmp_path: Path, key: str) -> None:
    with pytest.raises(InputError, match=rf"{re.escape(key)}: is empty, expected a value"):
        load_params(write(tmp_path, **{key: None}))


def test_aliases_stand_for_what_they_name(tmp_path: Path) -> None:
    text = write(tmp_path).read_text()
    (tmp_path / "params.yaml").write_text(text.replace("alpha: ", "alpha: &weight ") + "\n")
    alpha = load_params(tmp_path / "params.yaml").alpha
    changed = (tmp_path / "params.yaml").read_text().replace("beta: 5.0", "beta: *weight")
    (tmp_path / "params.yaml").write_text(changed)
    assert load_params(tmp_path / "params.yaml").beta == alpha


def test_what_the_system_says_of_the_file_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "params.yaml"
    path.mkdir()
    with pytest.raises(InputError, match=r"params\.yaml: can't be read: it is a folder"):
        load_params(path)
    path.rmdir()
    path.symlink_to(path)
    with pytest.raises(InputError, match=r"params\.yaml: can't be read: its symbolic links lead in a circle"):
        load_params(path)
    path.unlink()
    write(tmp_path)

    def refuse(*_: object, **__: object) -> str:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "read_text", refuse)  # Root may read everything.
    with pytest.raises(InputError, match=r"params\.yaml: can't be read: no permission"):
        load_params(path)


def test_files_that_are_no_params_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"params\.yaml: not found"):
        load_params(tmp_path / "params.yaml")
    (tmp_path / "params.yaml").write_text("scale: [")
    with pytest.raises(InputError, match="not valid YAML"):
        load_params(tmp_path / "params.yaml")


@pytest.mark.parametrize("name", ["simulate", "plan"])
def test_every_stage_ends_with_one_sentence(tmp_path: Path, name: str) -> None:
    write(tmp_path, **{"scales.laptop.simulate.seqences": 3})
    for folder in ("src", "stages"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    variant = {"plan": ["main"]}.get(name, [])
    command = [sys.executable, f"stages/{name}.py", *variant]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "src")}
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert ended.stderr == f"{name}: params.yaml: scales.laptop.simulate.seqences is not a known key\n"


def test_another_checkouts_code_is_refused(tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "stages" / "regularise.py")]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert "expected the clothkit of the current directory" in ended.stderr
