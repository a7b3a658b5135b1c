"""Sets the thresholds from which an observation counts as unknown: `python stages/set_alarms.py`."""

from pathlib import Path

from clothkit.dataset import store
from clothkit.estimation.alarms import save
from clothkit.evaluation.alarms import set_alarms
from clothkit.models.store import load
from clothkit.runtime.stage import stage


def main() -> None:
    """Write data/nets/alarms.npz."""
    with stage("set_alarms") as s:
        meshes, vtm = Path("data/meshes.zarr"), Path("data/nets/vtm")
        work = s.work(inputs=[meshes, vtm])
        stages = s.shared.stages
        alarms = set_alarms(
            load(vtm, "vtm"),
            store.load(meshes),
            s.params,
            trained=stages.train_vtm,
            camera=stages.evaluate_camera,
            refinement=stages.plan.refine,
        )
        save(work / "alarms.npz", alarms)
        s.publish(work / "alarms.npz", "data/nets/alarms.npz")


if __name__ == "__main__":
    main()
