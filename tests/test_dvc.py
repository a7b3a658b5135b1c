"""What people do with DVC: `-S` changes a line, plots are drawn, experiments run in copies, reports keep their lock."""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import networkx
import pandas as pd
import pytest
from dvc.repo import Repo
from dvc.utils.hydra import apply_overrides
from ruamel.yaml import YAML

from clothkit.dataset import store
from clothkit.evaluation import planning
from clothkit.params import load_params
from clothkit.planning import trust
from clothkit.planning.planner import artifacts
from clothkit.planning.systems import system
from clothkit.prebuilt.files import ALARMS
from clothkit.report import planning_tables, tables
from clothkit.report.plots import plots
from tests.documents import blocks, commands
from tests.evaluation.planning_rows import planning_rows
from tests.report.contents import dataset, tidy_tasks

ROOT = Path(__file__).parents[1]
PIPELINE = YAML(typ="safe").load(ROOT / "dvc.yaml")
LOCKS = sorted((ROOT / "reports").glob("*/dvc.lock"))
REPORTS = sorted((ROOT / "reports").glob("*/params.yaml"))


class Repository:
    """A git and DVC repository in a folder. No PYTHONPATH: what is installed is another checkout's clothkit."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        self.environment |= {
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "DVC_NO_ANALYTICS": "1",
            "JAX_PLATFORMS": "cpu",
        }
        self.run("git", "init", "-q")
        self.run("dvc", "init", "-q")

    def commit(self) -> None:
        self.run("git", "add", "-A")
        self.run("git", "-c", "user.name=test", "-c", "user.email=test@localhost", "commit", "-qm", "state")

    def run(self, *command: str, status: int = 0) -> str:
        ended = subprocess.run(
            command, cwd=self.folder, env=self.environment, capture_output=True, text=True, check=False
        )
        assert ended.returncode == status, ended.stdout + ended.stderr
        return ended.stdout + ended.stderr


# Values that no scale has, so that each of them is a change.
@pytest.mark.parametrize(
    "change",
    [
        "scale=paper",
        "alpha=0.123",
        "app.side=0.123",
        "scales.smoke.evaluate_camera.estimated=123",
        "scales.laptop.plan.search.optimiser.strains=123",
        "scales.overnight.train_vtm.rare=0.123",
        "scales.overnight.evaluate_camera.estimated=123",
        "scales.paper.train_vtm.training.stop_below=0.123",
    ],
)
def test_setting_a_param_changes_one_line(tmp_path: Path, change: str) -> None:
    before = (ROOT / "params.yaml").read_text()
    (tmp_path / "params.yaml").write_text(before)
    apply_overrides(tmp_path / "params.yaml", [change])
    after = (tmp_path / "params.yaml").read_text()
    pairs = list(zip(before.splitlines(), after.splitlines(), strict=True))
    changed = [(old, new) for old, new in pairs if old != new]
    assert len(changed) == 1
    assert changed[0][1].split(": ")[1].split("  #")[0] == change.split("=")[1]


def test_a_new_param_leaves_the_other_lines(tmp_path: Path) -> None:
    before = (ROOT / "params.yaml").read_text()
    (tmp_path / "params.yaml").write_text(before)
    apply_overrides(tmp_path / "params.yaml", ["++scales.laptop.simulate.simulation.material=jersey"])
    after = (tmp_path / "params.yaml").read_text()
    added = "      simulation:\n        material: jersey\n"
    assert after.replace(added, "", 1) == before


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What `dvc plots show` draws of made-up rows, by plot."""
    repository = Repository(tmp_path_factory.mktemp("plots"))
    params = {"scale": "smoke"}
    (repository.folder / "params.yaml").write_text(json.dumps(params))
    YAML().dump({"plots": PIPELINE["plots"]}, repository.folder / "dvc.yaml")
    shutil.copytree(ROOT / ".dvc" / "plots", repository.folder / ".dvc" / "plots")
    planned = planning_rows(("main", "b1"), sequences=2)
    history = pd.DataFrame({"iteration": [10, 20], "score": [0.4, 0.3]})
    tidy = pd.DataFrame({"z": [1.0, 2.0], "expected": [0.683, 0.954], "coverage": [0.6, 0.9], "axis": "all"})
    rows = plots(
        {"pemd_0": history, "pemd_1": history, "vtm": history},
        pd.concat([tidy.assign(split="test", system=name, length=1) for name in ("estimate", "main")]),
        tables.prediction(tidy_tasks(("main", "a1")), ("main", "a1")),
        planning_tables.planning(planned, planning.intervals(planned), ("main", "b1")),
    )
    folder = repository.folder / "reports" / "smoke" / "plots"
    folder.mkdir(parents=True)
    for name, table in rows.items():
        table.to_csv(folder / f"{name}.csv", index=False)
    repository.commit()
    shown = json.loads(repository.run("dvc", "plots", "show", "--json"))
    assert not shown.get("errors")
    return {name: content[0] for name, content in shown["data"].items()}


@pytest.mark.parametrize(
    ("plot", "column", "values", "x", "y"),
    [
        ("learning curves", "line", {"pemd_0", "pemd_1", "vtm"}, "iteration", "error"),
        ("calibration", "line", {"estimates, 1", "predictions, 1", "ideal"}, "expected", "coverage"),
        ("errors of predictions", "line", {"main", "a1"}, "length", "error"),
        ("errors of plans", "line", {"main", "b1"}, "length", "error"),
        ("table 6", "task", set(tables.TASKS), "error", "system"),
    ],
)
def test_every_plot_is_drawn(drawn: dict[str, Any], plot: str, column: str, values: set[str], x: str, y: str) -> None:
    content = drawn[plot]["content"]
    points = content["data"]["values"]
    assert {point[column] for point in points} == values
    assert all(x in point and y in point for point in points)
    assert "<DVC_METRIC" not in json.dumps(content)
    encoding = content.get("spec", content)["encoding"]
    assert (encoding["x"]["field"], encoding["y"]["field"]) == (x, y)
    drawn_fields = {channel["field"] for channel in encoding.values()} | {content.get("facet", {}).get("field")}
    assert {column, "rev"} <= drawn_fields


def test_no_plot_is_forgotten(drawn: dict[str, Any]) -> None:
    assert len(drawn) == len(PIPELINE["plots"]) == 5


@pytest.fixture(scope="module")
def experiments(tmp_path_factory: pytest.TempPathFactory) -> Repository:
    """A checkout with a pipeline of one cheap stage, as dvc.yaml has it, whose input is in git."""
    repository = Repository(tmp_path_factory.mktemp("experiments"))
    for name in ("src", "stages"):
        shutil.copytree(ROOT / name, repository.folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    params = YAML(typ="safe").load(ROOT / "params.yaml")
    YAML().dump({**params, "scale": "smoke"}, repository.folder / "params.yaml")
    YAML().dump({"stages": {"augment": PIPELINE["stages"]["augment"]}}, repository.folder / "dvc.yaml")
    (repository.folder / ".gitignore").write_text("/.work/\n__pycache__/\n")
    store.save(repository.folder / "data" / "meshes.zarr", dataset(), {})
    package = repository.folder / "src" / "clothkit" / "__init__.py"
    package.write_text(package.read_text() + '\nprint("this is", __file__)\n')
    repository.commit()
    return repository


def test_an_experiment_in_a_copy_runs_the_copys_code(experiments: Repository) -> None:
    output = experiments.run("dvc", "exp", "run", "--temp", "-S", "scales.smoke.augment.variants=3")
    ran = Path(output.split("this is ")[1].splitlines()[0])
    assert ran.is_relative_to(experiments.folder / ".dvc" / "tmp" / "exps")
    assert ran.parts[-3:] == ("src", "clothkit", "__init__.py")
    assert not (experiments.folder / "data" / "augmented.zarr").exists()
    assert "Ran experiment" in output


def test_a_clothkit_elsewhere_in_the_checkout_is_refused(experiments: Repository) -> None:
    source = shutil.copytree(experiments.folder / "src", experiments.folder / ".work" / "src")
    ended = subprocess.run(
        [sys.executable, "stages/augment.py"],
        cwd=experiments.folder,
        env={**experiments.environment, "PYTHONPATH": str(source)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 1
    expected = f"the clothkit of the current directory, {experiments.folder}/src/clothkit;"
    assert ended.stderr.startswith(f"augment: {source}/clothkit/__init__.py: expected {expected}")
    assert len(ended.stderr.splitlines()) == 1


def md5(path: Path) -> str:
    """What DVC writes into a lock for a file or a folder."""
    if path.is_file():
        return hashlib.md5(path.read_bytes()).hexdigest()
    files = sorted(file for file in path.rglob("*") if file.is_file())
    entries = [{"md5": md5(file), "relpath": file.relative_to(path).as_posix()} for file in files]
    listing = json.dumps(sorted(entries, key=lambda entry: entry["relpath"]), sort_keys=True)
    return f"{hashlib.md5(listing.encode()).hexdigest()}.dir"


@pytest.mark.parametrize("lock", LOCKS, ids=lambda path: path.parent.name)
def test_a_reports_lock_is_the_reports(lock: Path) -> None:
    """It names the very files that lie beside it, and the params that they say they were made with.

    A stage that was not run since its outs changed in dvc.yaml is not held to what it made.
    """
    stages = YAML(typ="safe").load(lock)["stages"]
    folder = f"reports/{lock.parent.name}/"
    outs = {name: {out["path"]: out["md5"] for out in stage.get("outs", [])} for name, stage in stages.items()}
    listed = {path for own in outs.values() for path in own}
    assert {f"{folder}README.md", f"{folder}tables", f"{folder}metrics.json"} <= listed
    held = [own for name, own in outs.items() if own.keys() == written_by(name, lock.parent.name)]
    assert any(f"{folder}README.md" in own for own in held)
    for path, digest in ((path, digest) for own in held for path, digest in own.items() if path.startswith(folder)):
        assert md5(ROOT / path) == digest, f"{path} is not what {lock} made; run dvc repro"
    said = YAML(typ="safe").load(lock.parent / "params.yaml")
    for stage in stages.values():
        for dotted, value in stage.get("params", {}).get("params.yaml", {}).items():
            assert covers(look_up(said, dotted), value), f"{dotted} is another in {lock} than in the params beside it"


def written_by(stage: str, scale: str) -> set[str]:
    """The outs of a stage, metrics among them, as dvc.yaml has them now."""
    name, _, item = stage.partition("@")
    definition = PIPELINE["stages"][name].get("do", PIPELINE["stages"][name])
    listed = [*definition.get("outs", []), *definition.get("metrics", [])]
    paths = (path if isinstance(path, str) else next(iter(path)) for path in listed)
    return {path.replace("${scale}", scale).replace("${item}", item) for path in paths}


def look_up(tree: Any, dotted: str) -> Any:
    for key in dotted.split("."):
        tree = tree[key]
    return tree


def covers(whole: Any, part: Any) -> bool:
    """Whether settings with their defaults agree with those that were set."""
    if isinstance(part, dict):
        return all(key in whole and covers(whole[key], value) for key, value in part.items())
    return bool(whole == part)


@pytest.mark.parametrize("params", REPORTS, ids=lambda path: path.parent.name)
def test_every_report_has_its_lock_or_a_reason(params: Path) -> None:
    reasons = (ROOT / "reports" / "README.md").read_text()
    assert (params.parent / "dvc.lock").exists() or f"`{params.parent.name}` has no lock" in reasons


@pytest.mark.filterwarnings("ignore::DeprecationWarning:pygtrie")
@pytest.mark.filterwarnings("ignore::DeprecationWarning:dvc")
def test_the_lock_is_kept_last(tmp_path: Path) -> None:
    """Every other stage runs before it, so that none is left out."""
    repository = Repository(tmp_path)
    for name in ("dvc.yaml", "params.yaml"):
        shutil.copy(ROOT / name, tmp_path)
    with Repo(str(repository.folder)) as repo:
        graph = repo.index.graph
        lock = next(stage for stage in graph if stage.name == "lock")
        left_out = set(graph) - {lock} - networkx.descendants(graph, lock)
        assert [stage.name for stage in left_out] == []
        assert len(graph) > 15


@pytest.mark.filterwarnings("ignore::DeprecationWarning:pygtrie")
@pytest.mark.filterwarnings("ignore::DeprecationWarning:dvc")
@pytest.mark.parametrize("members", [[0], [0, 1, 7]])
def test_every_member_is_trained_for_what_needs_the_ensemble(tmp_path: Path, members: list[int]) -> None:
    """And nothing else is: no stage waits for the nets of another kind."""
    repository = Repository(tmp_path)
    for name in ("dvc.yaml", "params.yaml"):
        shutil.copy(ROOT / name, tmp_path)
    apply_overrides(tmp_path / "params.yaml", [f"ensemble.members={members}"])
    with Repo(str(repository.folder)) as repo:
        graph = repo.index.graph
        named = {stage.name: stage for stage in graph}
        before = {name: {stage.name for stage in networkx.descendants(graph, named[name])} for name in named}
    mesh, voxel = ({f"train_{kind}@{member}" for member in members} for kind in ("pemd", "emd_voxel"))
    assert {name for name in named if name.startswith(("train_pemd", "train_emd_voxel"))} == mesh | voxel
    every = mesh | voxel | {"train_vtm"}
    for name, needed in {
        "normalise@mesh": mesh,
        "normalise@voxel": voxel,
        "plan@b1": mesh,
        "plan@main": mesh | {"train_vtm"},
        "plan_fixed@b5": voxel,
        "evaluate_prediction": every,
    }.items():
        assert before[name] & every == needed, name


def test_what_plans_are_made_with_can_be_pulled() -> None:
    """The artifacts by name, and the paths that the docs list, are what the planner of system main reads."""
    params = load_params(ROOT / "params.yaml")
    measure = params.stages.plan.uncertainty.measure
    needed = artifacts(system("main"), Path("data"), params.ensemble.members, measure).values()
    # What is read where it is there.
    every = {path.as_posix() for path in needed} | {f"data/{ALARMS}", f"data/{trust.PLACE}"}
    named = {artifact["path"] for artifact in PIPELINE["artifacts"].values()}
    assert named == every | {"data/meshes.zarr", "prebuilt/household"}
    told = blocks(ROOT / "docs/gpu-and-cluster.md")
    pulled = [words[3:] for block in told for words in commands(block.code) if words[1:3] == ["dvc", "pull"]]
    assert [set(paths) for paths in pulled if paths] == [every]


def test_the_lock_is_kept_without_its_own_stage(tmp_path: Path) -> None:
    (tmp_path / "reports" / "smoke").mkdir(parents=True)
    params = (ROOT / "params.yaml").read_text()
    (tmp_path / "params.yaml").write_text(re.sub("(?m)^scale: .*", "scale: smoke", params))
    command = [sys.executable, str(ROOT / "stages" / "lock.py")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    before, own, after = (f"  {name}:\n    outs:\n    - path: {name}\n" for name in ("augment", "lock", "lock_two"))
    head = "schema: '2.0'\nstages:\n"
    for status in (1, 0):
        ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert ended.returncode == status, ended.stderr
        if status:
            assert ended.stderr == "lock: dvc.lock: not found, expected what dvc repro writes\n"
            (tmp_path / "dvc.lock").write_text(head + before + own + after)
    assert (tmp_path / "reports" / "smoke" / "dvc.lock").read_text() == head + before + after
