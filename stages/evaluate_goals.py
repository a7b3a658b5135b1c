"""Plans for named goals, from true meshes and before a depth camera: `python stages/evaluate_goals.py`."""

from pathlib import Path

from clothkit.dataset.rows import write_rows
from clothkit.episodes.depth_camera import depth_camera
from clothkit.evaluation import arrays
from clothkit.evaluation.camera import picture_settings
from clothkit.goals.outcomes import Planners, outcomes
from clothkit.goals.problems import problems
from clothkit.goals.rows import pictured, rows
from clothkit.goals.store import WORK
from clothkit.goals.tidy import PICTURED
from clothkit.planning.objective import Weights
from clothkit.planning.planner import artifacts, assemble
from clothkit.planning.systems import SYSTEMS
from clothkit.runtime.stage import stage
from clothkit.simulation.executor import end_workers, make_simulator

DATA = Path("data")
OUTS = ("goals.parquet", "goals.zarr")


def main() -> None:
    """Write data/evaluation/goals.parquet and goals.zarr."""
    with stage("evaluate_goals") as s:
        if s.params is None:
            s.leave_out(*(DATA / "evaluation" / name for name in OUTS))
            return
        stages, members = s.shared.stages, s.shared.ensemble.members
        work = s.work(inputs=list(artifacts(SYSTEMS["main"], DATA, members, stages.plan.uncertainty.measure).values()))
        weights = Weights(s.shared.alpha, s.shared.beta, s.shared.gamma)
        simulate, camera = stages.simulate, stages.evaluate_camera
        pieces = s.pieces(work, weights, stages.plan, simulate.decisive, camera)
        main_planner, mesh_planner = (
            assemble(SYSTEMS[name], DATA, weights, stages.plan, simulate.candidates, members) for name in ("main", "b1")
        )
        sensor = depth_camera(picture_settings(camera, s.params.condition), main_planner.perception)
        found = problems(s.params, simulate, work=pieces, goals=WORK)
        simulator = make_simulator(simulate)
        planners: Planners = {"mesh": (mesh_planner, None), "camera": (main_planner, sensor)}
        evaluated = outcomes(found, s.params.sources, planners, simulator, work=pieces)
        end_workers()
        write_rows(work / "goals.parquet", rows(evaluated), s.attributes)
        arrays.save(work / "goals.zarr", pictured(evaluated), PICTURED, s.attributes)
        for name in OUTS:
            s.publish(work / name, DATA / "evaluation" / name)


if __name__ == "__main__":
    main()
