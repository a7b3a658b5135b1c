"""The planner: a system with its nets, its observation model, its reference values and its settings."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax

from clothkit.dataset.store import STEPS
from clothkit.episodes.record import Sizes
from clothkit.manipulation.candidates import CandidateConfig
from clothkit.models import store
from clothkit.models.store import Kind
from clothkit.planning import normalisation
from clothkit.planning.loss import Weights
from clothkit.planning.normalisation import Normalisation
from clothkit.planning.search import Found, Problem, search
from clothkit.planning.settings import PlanConfig
from clothkit.planning.sight import MeshSight, Sight, VoxelSight
from clothkit.planning.systems import System, better_net


@dataclass(frozen=True)
class Planner:
    """A system with everything that its searches and sessions need."""

    system: System
    sight: Sight
    nets: tuple[Any, ...]
    better: int
    """Index into `nets` of the one with the better validation score."""
    normalisation: Normalisation
    weights: Weights
    settings: PlanConfig
    grasping: CandidateConfig

    @property
    def sizes(self) -> Sizes:
        """The sizes of the arrays in a record of this planner's sessions."""
        found, longest = self.settings.search, self.settings.search.iterations(STEPS)
        return Sizes(
            state=self.sight.shape,
            probabilistic=not self.system.voxels,
            candidate=self.grasping.most,
            net=len(self.nets),
            iteration=longest,
            strain=found.strains,
            restart=longest // found.patience + 1,
        )

    def finder(self, length: int) -> Callable[[Problem, jax.Array], Found]:
        """The search for plans of one length, as a function: problems, keys -> `Found`."""
        find = partial(
            search,
            self.sight.forward,
            length=length,
            settings=self.settings.search,
            explicit=float(self.weights.alpha) > 0,
        )
        reference = self.normalisation.reference(length)
        return lambda problems, keys: find(self.nets, problems, reference, self.weights, keys=keys)


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
    vtm = store.load(found["vtm"], "vtm") if "vtm" in found else None
    sight = VoxelSight() if system.voxels else MeshSight(vtm, settings.refine, refine=system.refine)
    folders = {net: found[net] for net in ("a", "b")}
    better = better_net(folders)
    kind: Kind = "emd_voxel" if system.voxels else "pemd"
    names = sorted(folders) if system.nets == 2 else [better]
    return Planner(
        system,
        sight,
        nets=tuple(store.load(folders[net], kind) for net in names),
        better=names.index(better),
        normalisation=normalisation.load(found["reference"]),
        weights=weights if system.alpha is None else weights._replace(alpha=system.alpha),
        settings=settings,
        grasping=grasping,
    )
