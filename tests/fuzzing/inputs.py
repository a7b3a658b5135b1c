"""What is mutated: tiny inputs of every loader and command, without a net that runs or a cloth that is simulated."""

import json
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import trimesh
import zarr
from ruamel.yaml import YAML

from clothkit.cloth.topology import SQUARE
from clothkit.dataset import store
from clothkit.dataset.regularise import regularise
from clothkit.dataset.rows import write_rows
from clothkit.episodes import record
from clothkit.evaluation import arrays
from clothkit.params import Params, load_params
from clothkit.simulation.records import write_raw
from clothkit.training import checkpoint
from tests.app import plans
from tests.evaluation.planning_rows import planning_rows
from tests.observation.pcds import written_pcd
from tests.observation.scenes import SCALE, folded
from tests.report.contents import tidy_tasks
from tests.simulation import arcsim_runs
from tests.tiny import ROOT, attempts, sessions, write_files, write_nets, write_params

SEARCH = {"optimiser": {"strains": 8, "base_iterations": 2, "iterations_per_step": 0}}


def write_inputs(folder: Path) -> None:
    """All of them, under their names in a current directory."""
    write_params(folder / "params.yaml")
    params = json.loads((folder / "params.yaml").read_text())
    plan = params["scales"]["smoke"]["plan"]
    plan["search"], plan["voxel_search"], plan["refine"] = SEARCH, SEARCH, {"iterations": 2}
    (folder / "params.yaml").write_text(json.dumps(params))
    of_report = YAML(typ="safe").load(ROOT / "reports/laptop/params.yaml")
    (folder / "report.yaml").write_text(json.dumps(of_report))
    (folder / "data").mkdir()
    write_nets(folder / "data")
    write_files(folder)
    _write_shapes(folder)
    plans.write(folder / "plan.json", plans.content())
    _write_tables(folder / "data", load_params(folder / "params.yaml"))


def _write_shapes(folder: Path) -> None:
    """The same cloth and cloud in other formats."""
    bent = folded(angle=0.3)
    np.save(folder / "mesh.npy", bent)
    np.save(folder / "goal.npy", folded(along=0.0))
    surface = trimesh.Trimesh(bent.reshape(-1, 3).astype(float) * SCALE, SQUARE.triangles(), process=False)
    surface.export(folder / "bent.ply", file_type="ply", encoding="ascii")
    silhouette = np.zeros((24, 24), dtype=bool)
    silhouette[4:20, 6:18] = True
    np.savez(folder / "silhouette.npz", silhouette=silhouette, pixel=np.float64(SCALE / 16))
    with np.load(folder / "cloud.npz") as stored:
        # Text takes long to read, many times over.
        points = stored["points"][stored["cloth"]][::4]
    cloud = trimesh.PointCloud(points)
    cloud.export(folder / "cloud.ply", file_type="ply", encoding="ascii")
    for name, data in (("cloud", "ascii"), ("binary", "binary"), ("compressed", "binary_compressed")):
        written_pcd(folder / f"{name}.pcd", points, data, header={"VIEWPOINT": "0 0 0 1 0 0 0"})
    made = zarr.create_array(folder / "own.zarr", shape=points.shape, dtype=points.dtype, chunks=(256, 3))
    made[:] = points


def _write_tables(data: Path, params: Params) -> None:
    """Sequences that nobody simulated, and what evaluations might say of them."""

    def about(stage: str) -> dict[str, object]:
        return {"stage": stage, "scale": params.scale, "params": params.section(stage)}

    tried = attempts()
    write_raw(data / "raw", tried, [tried.states[tried.accepted]], seed=0, attributes=about("simulate"))
    dataset = regularise(data / "raw", params.stages.regularise)
    store.save(data / "meshes.zarr", dataset, about("regularise"))
    planning = data / "evaluation/planning"
    planning.mkdir(parents=True)
    done = sessions(dataset)
    for system in ("main", "b1"):
        record.save(planning / f"sessions_{system}.zarr", [done], about("plan"))
    write_rows(planning / "main.parquet", planning_rows(["main"], sequences=2), about("plan"))
    meshes = dataset.vertices[:3]
    estimates = {"sequence": np.arange(3), "mean": meshes, "mesh": meshes, "std": np.full_like(meshes, 0.02)}
    estimates["label"] = np.zeros((3, 4), np.int32)
    arrays.save(data / "evaluation/estimates.zarr", estimates, arrays.ESTIMATES, about("evaluate_estimation"))
    keys = product(("test", "train"), range(2), (1, 2, 3), ("pmr", "dmr"))
    rows = pd.DataFrame(keys, columns=["split", "sequence", "state", "kind"])
    rows = rows.assign(error=0.02, error_labelled=0.03, error_no_action=0.2, sigma_ratio=0.8)
    write_rows(data / "evaluation/estimation.parquet", rows, about("evaluate_estimation"))
    tasks = tidy_tasks(("main", "a1"), sequences=2).assign(voxel_error_025=0.01)
    write_rows(data / "evaluation/prediction.parquet", tasks, about("evaluate_prediction"))
    work = data.with_name("work")
    work.mkdir()
    record.save_piece(work / "sessions_000.npz", done)
    np.savez(work / "block.npz", **attempts(2)._asdict())  # type: ignore[arg-type]
    checkpoint.write(work / "checkpoint", [np.arange(6.0), np.ones((2, 2), np.float32)], {"iteration": 3})
    note = {"stage": "plan@main", "seconds": 1.5, "cpu_seconds": 2.5, "peak_memory_mib": 800, "machine": "2 x x86_64"}
    note |= {"plans": {"1": [2, 0.5]}, "estimates": [2, 0.1]}
    (work / "plan@main.json").write_text(json.dumps(note))
    arcsim_runs.write_run(data.with_name("runs") / "half", {0: (0.4, 0.0), 1: (0.4, 0.0)})
    arcsim_runs.write_table(data.with_name("runs"), [[("half", 0), ("half", arcsim_runs.FRAME)]])
