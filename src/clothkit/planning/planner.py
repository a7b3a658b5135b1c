"""The planner: a system with its nets, its perception, its reference values and its settings."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax

from clothkit.manipulation.candidates import CandidateConfig
from clothkit.models import store
from clothkit.models.store import Kind
from clothkit.planning import normalisation
from clothkit.planning.forward_model import EMD_VOXEL, PEMD, ForwardModel
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.normalisation import Normalisation
from clothkit.planning.objective import Objective, Weights, objective_of
from clothkit.planning.perception import Estimation, KnownMeshes, ObservedVoxels, Perception
from clothkit.planning.representation import Representation
from clothkit.planning.search import search
from clothkit.planning.settings import PlanConfig
from clothkit.planning.systems import System, better_net
from clothkit.planning.types import Found, Problem
from clothkit.planning.voxel_representation import VOXEL


@dataclass(frozen=True)
class Planner:
    """A system with everything that an agent needs to decide."""

    system: System
    representation: Representation
    model: ForwardModel
    nets: tuple[Any, ...]
    better: int
    """Index into `nets` of the one with the better validation score."""
    perception: Perception
    normalisation: Normalisation
    weights: Weights
    settings: PlanConfig
    grasping: CandidateConfig
    labelled: bool = False
    """Whether states have the same labels as their goals, so that a search need not find the relative labelling."""

    def objective(self, length: int) -> Objective:
        """What a search for plans of that length minimises.

        Raises InputError when the nets have no reference values for plans of that length.
        """
        return objective_of(len(self.nets), self.normalisation.reference(length), self.weights)

    def search(self, problems: Problem, keys: jax.Array, *, length: int) -> Found:
        """The best plans of one length for a batch of problems."""
        return search(
            self.model,
            self.representation,
            self.nets,
            problems,
            self.objective(length),
            length=length,
            settings=self.settings.search,
            keys=keys,
        )


def artifacts(system: System, data: Path) -> dict[str, Path]:
    """Paths, by name, of the artifacts under `data` that a system needs.

    These are the nets a and b, the reference values and, for systems that estimate meshes, the VtM net.
    """
    kind, net = ("voxel", "emd_voxel") if system.voxels else ("mesh", "pemd")
    found = {name: data / f"nets/{net}_{name}" for name in ("a", "b")}
    found["reference"] = data / f"normalisation/{kind}.json"
    return {**found, "vtm": data / "nets/vtm"} if system.estimates else found


def assemble(system: System, data: Path, weights: Weights, settings: PlanConfig, grasping: CandidateConfig) -> Planner:
    """Load a system's planner from the artifacts under `data`. Raises InputError if one is missing or malformed."""
    found = artifacts(system, data)
    settings = settings.of(system)
    perception: Perception = ObservedVoxels() if system.voxels else KnownMeshes()
    if system.estimates:
        perception = Estimation(store.load(found["vtm"], "vtm"), settings.refine, refine=system.refine)
    folders = {net: found[net] for net in ("a", "b")}
    better = better_net(folders)
    kind: Kind = "emd_voxel" if system.voxels else "pemd"
    names = sorted(folders) if system.nets == 2 else [better]
    return Planner(
        system,
        representation=VOXEL if system.voxels else MESH,
        model=EMD_VOXEL if system.voxels else PEMD,
        nets=tuple(store.load(folders[net], kind) for net in names),
        better=names.index(better),
        perception=perception,
        normalisation=normalisation.load(found["reference"]),
        weights=weights if system.alpha is None else weights._replace(alpha=system.alpha),
        settings=settings,
        grasping=grasping,
        labelled=system.voxels or system.true_meshes,
    )
