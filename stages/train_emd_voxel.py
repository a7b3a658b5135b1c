"""Trains a member of the voxel baseline's ensemble, from its own random key: `python stages/train_emd_voxel.py 0`."""

import sys
from pathlib import Path

import jax

from clothkit.dataset import store
from clothkit.models.ensemble import folder, member_named
from clothkit.models.net import Net
from clothkit.models.store import save
from clothkit.runtime.stage import stage
from clothkit.training.emd_voxel import train_emd_voxel

NETS = Path("data/nets")


def main(name: str) -> None:
    """Write data/nets/emd_voxel/<member>, or a note where params.yaml has null for train_emd_voxel."""
    with stage("train_emd_voxel", name) as s:
        member = member_named(name, s.shared.ensemble.members)
        if s.params is None:
            s.leave_out(folder(NETS, "emd_voxel", member))
            return
        training, meshes = Path("data/augmented.zarr"), Path("data/meshes.zarr")
        work = s.work(inputs=[training, meshes])
        key = jax.random.fold_in(jax.random.key(s.params.training.seed), member)
        validation = store.load(meshes).of_split("validation")
        trained = train_emd_voxel(s.params, store.load(training), validation, work=work, key=key)
        attributes = {**s.attributes, "validation_score": trained.score}
        save(work / "net", Net(s.params.net, trained.params), trained.history, attributes)
        s.publish(work / "net", folder(NETS, "emd_voxel", member))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("train_emd_voxel: expected one argument, the number of a member of the ensemble")
    main(sys.argv[1])
