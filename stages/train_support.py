"""Trains the support model of the best forward net: `python stages/train_support.py`."""

from pathlib import Path

from clothkit.dataset import store
from clothkit.models.ensemble import folders, load
from clothkit.models.support_model import save
from clothkit.runtime.stage import stage
from clothkit.training.support_model import train


def main() -> None:
    """Write data/nets/support.npz."""
    with stage("train_support") as s:
        meshes, nets, members = Path("data/meshes.zarr"), Path("data/nets"), s.shared.ensemble.members
        work = s.work(inputs=[meshes, *folders(nets, "pemd", members).values()])
        ensemble = load(nets, "pemd", members)
        training = store.load(meshes).of_split("train")
        save(work / "support.npz", train(ensemble.model, ensemble.best_net.params, training, s.params))
        s.publish(work / "support.npz", nets / "support.npz")


if __name__ == "__main__":
    main()
