"""Plans and executes all tasks with one of the systems: `python stages/plan.py main` (or b1, b2, ..)."""

import sys
from functools import partial
from pathlib import Path

import pandas as pd

from clothkit.dataset import store
from clothkit.dataset.rows import write_rows
from clothkit.episodes.evaluate import cost, evaluate
from clothkit.episodes.record import save
from clothkit.evaluation.diagnosis import diagnosed
from clothkit.evaluation.session_rows import rows
from clothkit.planning.objective import Weights
from clothkit.planning.planner import artifacts, assemble
from clothkit.planning.systems import SYSTEMS
from clothkit.runtime.stage import stage
from clothkit.simulation.executor import end_workers, make_simulator

DATA = Path("data")
MESHES = DATA / "meshes.zarr"


def main(name: str) -> None:
    """Write data/evaluation/planning/<system>.parquet and sessions_<system>.zarr."""
    system = SYSTEMS[name]
    with stage("plan", name) as s:
        outs = (f"data/evaluation/planning/sessions_{name}.zarr", f"data/evaluation/planning/{name}.parquet")
        if name not in s.params.systems:
            s.leave_out(*outs)
            return
        members = s.shared.ensemble.members
        work = s.work(inputs=[MESHES, *artifacts(system, DATA, members, s.params.uncertainty.measure).values()])
        weights = Weights(s.shared.alpha, s.shared.beta, s.shared.gamma)
        simulate = s.shared.stages.simulate
        planner = assemble(system, DATA, weights, s.params, simulate.candidates, members)
        pieces = s.pieces(work, planner.weights, planner.grasping, simulate.simulation)
        simulator = make_simulator(simulate)
        annotate = partial(diagnosed, planner=planner)
        sessions, times = evaluate(store.load(MESHES), planner, simulator, work=pieces, annotate=annotate)
        s.costs.update(cost(times))
        end_workers()
        attributes = {**s.attributes, **planner.weights._asdict(), "members": list(planner.members)}
        save(work / "sessions.zarr", sessions, attributes)
        found = pd.concat([rows(piece, name) for piece in sessions], ignore_index=True)
        write_rows(work / "rows.parquet", found, attributes)
        for file, out in zip(("sessions.zarr", "rows.parquet"), outs, strict=True):
            s.publish(work / file, out)


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] not in SYSTEMS:
        sys.exit(f"plan: expected one argument, {' or '.join(SYSTEMS)}")
    main(sys.argv[1])
