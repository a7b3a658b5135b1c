"""Plans and executes every task with one of the systems: `python stages/plan.py main` (or b1, b2, ..)."""

import hashlib
import sys
from functools import partial
from pathlib import Path

from clothkit.dataset import store
from clothkit.dataset.rows import write_rows
from clothkit.networks.store import load
from clothkit.planning import normalisation
from clothkit.planning.evaluate import cost, evaluate
from clothkit.planning.loss import Weights
from clothkit.planning.planner import Planner
from clothkit.planning.record import save
from clothkit.planning.rows import rows
from clothkit.planning.sight import MeshSight, VoxelSight
from clothkit.planning.systems import SYSTEMS, better_net
from clothkit.simulation.executor import execute
from clothkit.stage import stage

MESHES, VTM = Path("data/meshes.zarr"), Path("data/nets/vtm")


def main(name: str) -> None:
    """Write data/evaluation/planning/<system>.parquet and sessions_<system>.zarr."""
    system = SYSTEMS[name]
    reference = Path(f"data/normalisation/{'voxel' if system.voxels else 'mesh'}.json")
    nets = {net: Path(f"data/nets/{'emd_voxel' if system.voxels else 'pemd'}_{net}") for net in ("a", "b")}
    estimating = not (system.voxels or system.true_meshes)
    with stage("plan", name) as s:
        work = s.work(inputs=[MESHES, reference, *nets.values()] + [VTM] * estimating)
        settings = s.params.of(system)
        sight = (
            VoxelSight()
            if system.voxels
            else MeshSight(load(VTM) if estimating else None, settings.refine, refine=system.refine)
        )
        weights = Weights(s.shared.alpha if system.alpha is None else system.alpha, s.shared.beta, s.shared.gamma)
        better = better_net(nets)
        names = sorted(nets) if system.nets == 2 else [better]
        planner = Planner(
            system,
            sight,
            tuple(load(nets[net]) for net in names),
            names.index(better),
            normalisation.load(reference),
            weights,
            settings,
            s.shared.stages.simulate.candidates,
        )
        simulation = s.shared.stages.simulate.simulation
        # Pieces of a run with other weights or another world are not this run's.
        pieces = work / hashlib.sha256(repr((weights, planner.grasping, simulation)).encode()).hexdigest()[:16]
        sessions, clock = evaluate(store.load(MESHES), planner, partial(execute, settings=simulation), work=pieces)
        s.costs.update(plans=cost(clock))
        attributes = {**s.attributes, **weights._asdict()}
        save(work / "sessions.zarr", sessions, attributes)
        write_rows(work / "rows.parquet", rows(sessions, name), attributes)
        s.publish(work / "sessions.zarr", f"data/evaluation/planning/sessions_{name}.zarr")
        s.publish(work / "rows.parquet", f"data/evaluation/planning/{name}.parquet")


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] not in SYSTEMS:
        sys.exit(f"plan: expected one argument, {' or '.join(SYSTEMS)}")
    main(sys.argv[1])
