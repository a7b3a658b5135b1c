"""Sets the thresholds from which an observation counts as unknown: `python stages/set_alarms.py`."""

from pathlib import Path

from clothkit.dataset import store
from clothkit.estimation.alarms import save
from clothkit.estimation.support import fit
from clothkit.evaluation.alarms import set_alarms
from clothkit.models.store import load
from clothkit.runtime.stage import stage
from clothkit.training.vtm import example_units


def main() -> None:
    """Write data/nets/alarms.npz."""
    with stage("set_alarms") as s:
        meshes, vtm = Path("data/meshes.zarr"), Path("data/nets/vtm")
        work = s.work(inputs=[meshes, vtm])
        stages, dataset, net = s.shared.stages, store.load(meshes), load(vtm, "vtm")
        training = dataset.of_split("train")
        units = example_units(net, training, stages.train_vtm, examples=s.params.examples, seed=s.params.seed)
        alarms = set_alarms(
            net,
            dataset,
            s.params,
            support=fit(units),
            camera=stages.evaluate_camera,
            refinement=stages.plan.refine,
        )
        save(work / "alarms.npz", alarms)
        s.publish(work / "alarms.npz", "data/nets/alarms.npz")


if __name__ == "__main__":
    main()
