"""Executes validation plans, and learns how far their expectation can be trusted: `python stages/calibrate.py`."""

from pathlib import Path

from clothkit.dataset import store
from clothkit.dataset.rows import write_rows
from clothkit.evaluation.trust import execute_planned, rows
from clothkit.planning import error_map, trust
from clothkit.planning.objective import Weights
from clothkit.planning.planner import artifacts, assemble
from clothkit.planning.systems import SYSTEMS
from clothkit.runtime.stage import stage
from clothkit.simulation.executor import end_workers, make_simulator

DATA = Path("data")
MESHES = DATA / "meshes.zarr"


def main() -> None:
    """Write data/evaluation/trust.parquet and data/normalisation/trust.json."""
    with stage("calibrate") as s:
        system, members = SYSTEMS["main"], s.shared.ensemble.members
        plan, simulate = s.shared.stages.plan, s.shared.stages.simulate
        work = s.work(inputs=[MESHES, *artifacts(system, DATA, members, plan.uncertainty.measure).values()])
        weights = Weights(s.shared.alpha, s.shared.beta, s.shared.gamma)
        pieces = s.pieces(work, weights, plan, simulate.decisive)
        planner = assemble(system, DATA, weights, plan, simulate.candidates, members)
        simulator = make_simulator(simulate)
        planned = execute_planned(store.load(MESHES), s.params, planner, simulator, work=pieces)
        end_workers()
        table, found = rows(planned)
        write_rows(work / "trust.parquet", table, s.attributes)
        error_map.save(work / "trust.json", found, s.attributes)
        s.publish(work / "trust.parquet", DATA / "evaluation/trust.parquet")
        s.publish(work / "trust.json", DATA / trust.PLACE)


if __name__ == "__main__":
    main()
