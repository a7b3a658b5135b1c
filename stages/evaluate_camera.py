"""Evaluates estimates and plans from depth pictures of the test cloths: `python stages/evaluate_camera.py`."""

from pathlib import Path

from clothkit.dataset import store
from clothkit.dataset.rows import write_rows
from clothkit.episodes import record
from clothkit.estimation.alarms import load as load_alarms
from clothkit.evaluation import arrays, camera, camera_planning
from clothkit.models.store import load
from clothkit.planning.objective import Weights
from clothkit.planning.planner import artifacts, assemble
from clothkit.planning.systems import SYSTEMS
from clothkit.runtime.stage import stage
from clothkit.simulation.executor import end_workers, make_simulator

DATA = Path("data")
MESHES, SESSIONS = DATA / "meshes.zarr", DATA / "evaluation/planning/sessions_main.zarr"
ALARMS = DATA / "nets/alarms.npz"
OUT = DATA / "evaluation/camera"


def main() -> None:
    """Write estimation.parquet, planning.parquet, comparisons.parquet and pictures.zarr in data/evaluation/camera."""
    with stage("evaluate_camera") as s:
        system = SYSTEMS["main"]
        members = s.shared.ensemble.members
        plan, simulate = s.shared.stages.plan, s.shared.stages.simulate
        found = artifacts(system, DATA, members, plan.uncertainty.measure)
        work = s.work(inputs=[MESHES, SESSIONS, ALARMS, *found.values()])
        weights = Weights(s.shared.alpha, s.shared.beta, s.shared.gamma)
        dataset = store.load(MESHES)
        vtm = load(found["vtm"], "vtm")
        alarms = load_alarms(ALARMS, units=vtm.config.hidden)
        pieces = s.pieces(work, weights, plan, simulate.decisive)
        estimation = camera.estimation(dataset, vtm, s.params, plan.refine, alarms, work=pieces / "states")
        planner = assemble(system, DATA, weights, plan, simulate.candidates, members)
        simulator = make_simulator(simulate)
        baseline = record.load(SESSIONS)
        planning = camera_planning.planning(dataset, planner, simulator, baseline, s.params, work=pieces / "sessions")
        end_workers()
        arrays.save(work / "pictures.zarr", estimation.arrays, arrays.PICTURES, s.attributes)
        write_rows(work / "estimation.parquet", estimation.rows, s.attributes)
        write_rows(work / "planning.parquet", planning, s.attributes)
        write_rows(work / "comparisons.parquet", camera_planning.comparisons(planning), s.attributes)
        for name in ("pictures.zarr", "estimation.parquet", "planning.parquet", "comparisons.parquet"):
            s.publish(work / name, OUT / name)


if __name__ == "__main__":
    main()
