"""Plans and executes every task with one of the systems: `python stages/plan.py main` (or b1, b2, b3)."""

import hashlib
import sys
from functools import partial
from pathlib import Path

from clothkit.dataset import store
from clothkit.dataset.rows import write_rows
from clothkit.networks.store import load
from clothkit.planning import normalisation
from clothkit.planning.evaluate import evaluate
from clothkit.planning.loss import Weights
from clothkit.planning.record import save
from clothkit.planning.rows import rows
from clothkit.planning.session import Planner
from clothkit.planning.systems import SYSTEMS, better_net
from clothkit.simulation.executor import execute
from clothkit.stage import stage

MESHES, VTM, REFERENCE = Path("data/meshes.zarr"), Path("data/nets/vtm"), Path("data/normalisation/mesh.json")
NETS = {"a": Path("data/nets/pemd_a"), "b": Path("data/nets/pemd_b")}


def main(name: str) -> None:
    """Write data/evaluation/planning/<system>.parquet and sessions_<system>.zarr."""
    system = SYSTEMS[name]
    with stage("plan", name) as s:
        inputs = [MESHES, REFERENCE, *NETS.values()] + ([] if system.true_meshes else [VTM])
        work = s.work(inputs=inputs)
        alpha = s.shared.alpha if system.alpha is None else system.alpha
        weights = Weights(alpha, s.shared.beta, s.shared.gamma)
        better = better_net(NETS)
        names = sorted(NETS) if system.nets == 2 else [better]
        planner = Planner(
            system,
            tuple(load(NETS[net]) for net in names),
            names.index(better),
            None if system.true_meshes else load(VTM),
            normalisation.load(REFERENCE),
            weights,
            s.params,
            s.shared.stages.simulate.candidates,
        )
        simulation = s.shared.stages.simulate.simulation
        # Pieces of a run with other weights or another world are not this run's.
        pieces = work / hashlib.sha256(repr((weights, planner.grasping, simulation)).encode()).hexdigest()[:16]
        sessions = evaluate(store.load(MESHES), planner, partial(execute, settings=simulation), work=pieces)
        attributes = {**s.attributes, **weights._asdict()}
        save(work / "sessions.zarr", sessions, attributes)
        write_rows(work / "rows.parquet", rows(sessions, name), attributes)
        s.publish(work / "sessions.zarr", f"data/evaluation/planning/sessions_{name}.zarr")
        s.publish(work / "rows.parquet", f"data/evaluation/planning/{name}.parquet")


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] not in SYSTEMS:
        sys.exit(f"plan: expected one argument, {' or '.join(SYSTEMS)}")
    main(sys.argv[1])
