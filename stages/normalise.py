"""Computes the planning loss's reference values, eqs. (14) and (15): `python stages/normalise.py mesh` (or voxel)."""

import sys
from pathlib import Path

from clothkit.dataset import store
from clothkit.models.ensemble import folders, load
from clothkit.models.store import Kind
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.normalisation import normalise, save
from clothkit.planning.representation import Representation
from clothkit.planning.voxel_representation import VOXEL
from clothkit.runtime.stage import is_left_out, stage

MESHES, NETS = Path("data/meshes.zarr"), Path("data/nets")
KINDS: dict[str, tuple[Kind, Representation]] = {"mesh": ("pemd", MESH), "voxel": ("emd_voxel", VOXEL)}


def main(kind: str) -> None:
    """Write data/normalisation/<kind>.json."""
    net, representation = KINDS[kind]
    with stage("normalise", kind) as s:
        members = s.shared.ensemble.members
        if any(map(is_left_out, folders(NETS, net, members).values())):
            s.leave_out(f"data/normalisation/{kind}.json")
            return
        work = s.work(inputs=[MESHES, *folders(NETS, net, members).values()])
        ensemble = load(NETS, net, members)
        validation = store.load(MESHES).of_split("validation")
        normalisation = normalise(ensemble.model, representation, ensemble.params, validation, s.params)
        save(work / f"{kind}.json", normalisation, s.attributes)
        s.publish(work / f"{kind}.json", f"data/normalisation/{kind}.json")


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] not in KINDS:
        sys.exit(f"normalise: expected one argument, {' or '.join(KINDS)}")
    main(sys.argv[1])
