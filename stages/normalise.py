"""Computes the planning loss's reference values, eqs. (14) and (15): `python stages/normalise.py mesh` (or voxel)."""

import sys
from pathlib import Path
from typing import Any

from clothkit.dataset import store
from clothkit.models.ensemble import folders, load
from clothkit.models.store import Kind
from clothkit.planning.forward import MESH
from clothkit.planning.normalisation import normalise, save
from clothkit.planning.recorded import in_meshes, in_voxels
from clothkit.planning.voxel_forward import VOXEL
from clothkit.stage import stage

MESHES, NETS = Path("data/meshes.zarr"), Path("data/nets")
KINDS: dict[str, tuple[Kind, Any, Any]] = {"mesh": ("pemd", MESH, in_meshes), "voxel": ("emd_voxel", VOXEL, in_voxels)}


def main(kind: str) -> None:
    """Write data/normalisation/<kind>.json."""
    net, forward, recorded = KINDS[kind]
    with stage("normalise", kind) as s:
        members = s.shared.ensemble.members
        work = s.work(inputs=[MESHES, *folders(NETS, net, members).values()])
        nets = load(NETS, net, members).nets
        validation = store.load(MESHES).of_split("validation")
        normalisation = normalise(forward, nets, validation, s.params, recorded=recorded)
        save(work / f"{kind}.json", normalisation, s.attributes)
        s.publish(work / f"{kind}.json", f"data/normalisation/{kind}.json")


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] not in KINDS:
        sys.exit(f"normalise: expected one argument, {' or '.join(KINDS)}")
    main(sys.argv[1])
