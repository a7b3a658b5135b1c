"""Bad params end in one sentence that names the key. The params are the tests' own: the workspace's may be changed."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from clothkit.errors import InputError
from clothkit.params import load_params

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
    assert set(params.scales) == {"smoke", "laptop", "overnight", "paper"}
    assert hash(params.stages.plan) == hash(params.stages.plan)
    assert params.section("regularise")["train"] == params.stages.regularise.train


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
        ({"scales.laptop.regularise.train": 3.5}, "scales.laptop.regularise.train: input should be a valid integer"),
        ({"scales.laptop.simulate.source": "arksim"}, "simulate.source: input should be 'own' or 'arcsim', found"),
        ({"alpha": -1.0}, "alpha: input should be greater than or equal to 0"),
        ({"app.side": -0.4}, "app.side: input should be greater than 0, found -0.4"),
        ({"app.reach": {"low": [0.0, 0.0, 0.0]}}, "app.reach.high is missing"),
        ({"scale": "huge"}, "scale: input should be 'smoke', 'laptop', 'overnight' or 'paper'"),
        ({"scales.paper.regularise": ...}, "scales.paper.regularise is missing"),
    ],
)
def test_bad_params_are_refused_by_name(tmp_path: Path, changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=re.escape(sentence)):
        load_params(write(tmp_path, **changes))


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
