"""Trains the voxel-to-mesh net: `python stages/train_vtm.py`."""

from pathlib import Path

import jax

from clothkit.dataset import store
from clothkit.models.net import Net
from clothkit.models.store import save
from clothkit.runtime.stage import stage
from clothkit.training.recalibration import recalibrated
from clothkit.training.vtm import train_vtm


def main() -> None:
    with stage("train_vtm") as s:
        meshes = Path("data/meshes.zarr")
        work = s.work(inputs=[meshes])
        dataset = store.load(meshes)
        key = jax.random.key(s.params.training.seed)
        training, validation = dataset.of_split("train"), dataset.of_split("validation")
        trained = train_vtm(s.params, training, validation, work=work, key=key)
        attributes = {**s.attributes, "validation_score": trained.score}
        net = Net(s.params.net, trained.params)
        net = recalibrated(net, validation) if s.params.recalibrate else net
        save(work / "net", net, trained.history, attributes)
        s.publish(work / "net", "data/nets/vtm")


if __name__ == "__main__":
    main()
