"""The whole chain at smoke scale: it ends, repeats nothing, survives kills with the same bytes, reruns what it must.

The pipeline runs in a copy of the tree, so that the user's data, params and cache are left alone.
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.slow

LONG_STAGES = ("simulate", "train_pemd@0", "train_vtm", "plan@main")


class Checkout:
    """A copy of the sources in a folder, with a git repository and params at smoke scale of its own."""

    def __init__(self, folder: Path, sources: Path = ROOT) -> None:
        self.folder = folder
        for name in ("src", "stages", "dvc.yaml", "params.yaml", ".dvcignore"):
            source = sources / name
            if source.is_dir():
                shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(source, folder / name)
        yaml = YAML()
        params = yaml.load(folder / "params.yaml")
        params["scale"], params["alpha"] = "smoke", 1.0
        yaml.dump(params, folder / "params.yaml")
        (folder / ".gitignore").write_text("/.work/\n__pycache__/\n")
        self.environment = {
            **os.environ,
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": str(folder / "src"),
            "JAX_PLATFORMS": "cpu",
            "DVC_NO_ANALYTICS": "1",
            # The chain runs what it compiles more often than other tests do.
            "XLA_FLAGS": "--xla_backend_optimization_level=1",
        }
        # Its processes are many, and import the same.
        self.environment.pop("PYTHONDONTWRITEBYTECODE", None)
        self.run("git", "init", "-q")
        self.run("dvc", "init", "-q")
        self.commit()

    def start(self, *command: str) -> subprocess.Popen[str]:
        """A command in a process group of its own."""
        pipe: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        return subprocess.Popen(
            command, cwd=self.folder, env=self.environment, text=True, start_new_session=True, **pipe
        )

    def run(self, *command: str, status: int = 0) -> str:
        """What a command prints; it must end with the given status."""
        process = self.start(*command)
        output, _ = process.communicate()
        assert process.returncode == status, output
        return output

    def commit(self) -> None:
        """Everything into git, which `dvc exp run` needs."""
        self.run("git", "add", "-A")
        self.run("git", "-c", "user.name=test", "-c", "user.email=test@localhost", "commit", "-qm", "state")

    def outs(self, stage: str) -> dict[str, str]:
        """The hash of every out of a stage, by path."""
        outs = YAML(typ="safe").load(self.folder / "dvc.lock")["stages"][stage]["outs"]
        return {out["path"]: out["md5"] for out in outs}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Checkout:
    """A checkout in which the chain has run once, unbroken."""
    checkout = Checkout(tmp_path_factory.mktemp("unbroken"))
    checkout.run("dvc", "repro")
    return checkout


def ran(output: str) -> set[str]:
    """The stages that a dvc command ran."""
    lines = [line for line in output.splitlines() if line.startswith("Running stage '")]
    return {line.split("'")[1] for line in lines}


def test_the_chain_ends_with_tables_pictures_and_metrics(finished: Checkout) -> None:
    report = finished.folder / "reports" / "smoke"
    for name in (
        "README.md",
        "index.html",
        "metrics.json",
        "metrics.csv",
        "dvc.lock",
        "params.yaml",
        "timings.csv",
        "tables/table_5.csv",
        "tables/table_6.csv",
        "tables/table_7.csv",
        "tables/planning_comparisons.csv",
        "tables/failures.csv",
        "tables/largest.csv",
        "tables/camera_estimation.csv",
        "tables/camera_planning.csv",
        "plots/learning.csv",
        "plots/table_6.csv",
        "table_8.csv",
        "budgets.csv",
        "tables/table_4_025.csv",
        "tables/table_7_025.csv",
    ):
        assert (report / name).stat().st_size > 0
    assert list((report / "figures").glob("*.png"))
    calibration = pd.read_parquet(finished.folder / "data" / "evaluation" / "calibration.parquet")
    assert set(calibration["system"]) == {"estimate", "main", "a1"}
    assert calibration["coverage"].between(0, 1).all()
    table = pd.read_csv(report / "tables" / "table_6.csv")
    assert set(table.loc[table["source"] == "clothkit", "system"]) == {
        "main",
        "b1",
        "b2",
        "b3",
        "b4",
        "b5",
        "unrefined",
        "no action",
    }
    ours = table[(table["source"] == "clothkit") & (table["system"] == "main") & (table["statistic"] == "mean")]
    assert set(ours["split"]) == {"test"}
    assert (ours[["1/0", "2/1", "3/all"]].to_numpy() > 0).all()
    table = pd.read_csv(report / "tables" / "table_4.csv")
    ours = table[(table["source"] == "clothkit") & (table["statistic"] == "mean")]
    assert {"main", "a1", "main_occluded", "a2"} <= set(ours["system"])
    assert (ours[["1/0", "2/1", "3/all"]].to_numpy() > 0).all()


def test_a_second_repro_runs_nothing(finished: Checkout) -> None:
    assert ran(finished.run("dvc", "repro")) == set()


def test_alpha_reruns_what_plans_with_it(finished: Checkout) -> None:
    finished.commit()
    assert ran(finished.run("dvc", "exp", "run", "-S", "alpha=0", "plan@main")) == {"plan@main"}
    # Of the others only whether they would run: planning is most of the chain's time.
    planned = {"plan@b1", "plan@b4", "plan@unrefined", "evaluate_planning", "evaluate_camera"}
    assert ran(finished.run("dvc", "repro", "--dry")) >= planned
    assert not ran(finished.run("dvc", "repro", "--dry")) & {"plan_fixed@b2", "plan_fixed@b3", "plan_fixed@b5"}
    finished.run("git", "checkout", "-q", "params.yaml", "dvc.lock")
    finished.run("dvc", "checkout", "-q")


@pytest.mark.parametrize("stage", LONG_STAGES)
def test_killed_it_goes_on_to_the_same_bytes(finished: Checkout, tmp_path: Path, stage: str) -> None:
    checkout = copy_of(finished, tmp_path)
    again = ("dvc", "repro", "--single-item", "--force", "--no-run-cache", stage)
    process = checkout.start(*again)
    pieces = wait_for_pieces(tmp_path / ".work" / stage, process)
    assert process.poll() is None, f"{stage} ended before it was killed: {process.communicate()[0]}"
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    assert pieces
    assert not any((tmp_path / out).exists() for out in checkout.outs(stage))
    assert ran(checkout.run(*again)) == {stage}
    assert checkout.outs(stage) == finished.outs(stage)


def copy_of(finished: Checkout, folder: Path) -> Checkout:
    """Another checkout with the same data, in which everything is done."""
    checkout = Checkout(folder)
    shutil.copytree(finished.folder / "data", folder / "data", dirs_exist_ok=True)
    shutil.copy(finished.folder / "dvc.lock", folder)
    return checkout


def wait_for_pieces(folder: Path, process: subprocess.Popen[str], seconds: float = 240) -> list[Path]:
    """The resumable pieces of a stage, as soon as there are any; none when the process ends first."""
    until = time.monotonic() + seconds
    while time.monotonic() < until and process.poll() is None:
        pieces = [p for p in folder.rglob("*") if p.is_file() and p.suffix not in (".lock", ".tmp")]
        if pieces:
            return pieces
        time.sleep(0.02)
    return []


@pytest.mark.parametrize(
    ("damage", "stage", "sentence"),
    [
        ("truncated parquet", "regularise", "data/raw/manipulations.parquet: can't be read as parquet"),
        ("other grid", "augment", "data/meshes.zarr: vertices has shape"),
        ("nan", "augment", "data/meshes.zarr: vertices of sequence 1, state 2 is not finite"),
        ("truncated net", "normalise mesh", "data/nets/pemd/0"),
    ],
)
def test_bad_artifacts_end_in_one_sentence(
    finished: Checkout, tmp_path: Path, damage: str, stage: str, sentence: str
) -> None:
    for name in ("src", "stages", "data", "params.yaml"):
        source = finished.folder / name
        shutil.copytree(source, tmp_path / name) if source.is_dir() else shutil.copy(source, tmp_path / name)
    spoil(tmp_path / "data", damage)
    name, *variant = stage.split()
    environment = {**finished.environment, "PYTHONPATH": str(tmp_path / "src")}
    command = [sys.executable, f"stages/{name}.py", *variant]
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert ended.stderr.startswith(f"{name}: ")
    assert sentence in ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 1


def spoil(data: Path, damage: str) -> None:
    """Break one artifact."""
    import zarr

    if damage.startswith("truncated"):
        file = data / "raw/manipulations.parquet" if "parquet" in damage else data / "nets/pemd/0/net.msgpack"
        content = file.read_bytes()
        file.unlink()  # outs may be links into the cache
        file.write_bytes(content[: len(content) // 2])
        return
    shutil.copytree(data / "meshes.zarr", data / "copy.zarr")
    shutil.rmtree(data / "meshes.zarr")
    (data / "copy.zarr").rename(data / "meshes.zarr")
    group = zarr.open_group(data / "meshes.zarr")
    if damage == "other grid":
        group.create_array("vertices", shape=(10, 4, 16, 16, 3), dtype="f4", overwrite=True)
    else:
        group["vertices"][1, 2, 3, 4, 0] = float("nan")  # type: ignore[index]
