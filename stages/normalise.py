"""Computes the planning loss's reference values, eqs. (14) and (15): `python stages/normalise.py mesh` (or voxel)."""

import sys
from pathlib import Path
from typing import Any

from clothkit.dataset import store
from clothkit.models.store import Kind, load
from clothkit.planning.forward_model import EMD_VOXEL, PEMD
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.normalisation import normalise, save
from clothkit.planning.voxel_representation import VOXEL
from clothkit.stage import stage

MESHES, NETS = Path("data/meshes.zarr"), Path("data/nets")
KINDS: dict[str, tuple[Kind, Any, Any]] = {"mesh": ("pemd", PEMD, MESH), "voxel": ("emd_voxel", EMD_VOXEL, VOXEL)}


def main(kind: str) -> None:
    """Write data/normalisation/<kind>.json."""
    net, model, representation = KINDS[kind]
    folders = [NETS / f"{net}_a", NETS / f"{net}_b"]
    with stage("normalise", kind) as s:
        work = s.work(inputs=[MESHES, *folders])
        a, b = (load(folder, net) for folder in folders)
        validation = store.load(MESHES).of_split("validation")
        normalisation = normalise(model, representation, (a, b), validation, s.params)
        save(work / f"{kind}.json", normalisation, s.attributes)
        s.publish(work / f"{kind}.json", f"data/normalisation/{kind}.json")


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] not in KINDS:
        sys.exit(f"normalise: expected one argument, {' or '.join(KINDS)}")
    main(sys.argv[1])
