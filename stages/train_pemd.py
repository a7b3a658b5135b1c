"""Trains one of the two forward models, a or b, which differ in their random keys: `python stages/train_pemd.py a`."""

import sys
from pathlib import Path

import jax

from clothkit.dataset import store
from clothkit.models.net import Net
from clothkit.models.store import save
from clothkit.stage import stage
from clothkit.training.pemd import train_pemd

NETS = ("a", "b")


def main(name: str) -> None:
    with stage("train_pemd", name) as s:
        training, meshes = Path("data/augmented.zarr"), Path("data/meshes.zarr")
        work = s.work(inputs=[training, meshes])
        key = jax.random.fold_in(jax.random.key(s.params.training.seed), NETS.index(name))
        validation = store.load(meshes).of_split("validation")
        trained = train_pemd(s.params, store.load(training), validation, work=work, key=key)
        attributes = {**s.attributes, "validation_score": trained.score}
        save(work / "net", Net(s.params.net, trained.params), trained.history, attributes)
        s.publish(work / "net", f"data/nets/pemd_{name}")


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] not in NETS:
        sys.exit(f"train_pemd: expected one argument, {' or '.join(NETS)}")
    main(sys.argv[1])
