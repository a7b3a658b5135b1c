"""Reference values of the planning loss: `python stages/normalise.py mesh`."""

import sys
from pathlib import Path

from clothkit.dataset import store
from clothkit.networks.store import load
from clothkit.planning.forward import MESH
from clothkit.planning.normalisation import normalise, save
from clothkit.stage import stage

MESHES = Path("data/meshes.zarr")
NETS = {"mesh": (Path("data/nets/pemd_a"), Path("data/nets/pemd_b"))}


def main(kind: str) -> None:
    """Write data/normalisation/<kind>.json."""
    with stage("normalise", kind) as s:
        work = s.work(inputs=[MESHES, *NETS[kind]])
        a, b = (load(folder) for folder in NETS[kind])
        normalisation = normalise(MESH, (a, b), store.load(MESHES).of_split("validation"), s.params)
        save(work / f"{kind}.json", normalisation, s.attributes)
        s.publish(work / f"{kind}.json", f"data/normalisation/{kind}.json")


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] not in NETS:
        sys.exit(f"normalise: expected one argument, {' or '.join(NETS)}")
    main(sys.argv[1])
