"""The planner: a system with its nets, its perception, its reference values and its settings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax

from clothkit.manipulation.candidates import CandidateConfig
from clothkit.models import store
from clothkit.models.ensemble import Ensemble, folders, load
from clothkit.models.forward import ForwardModel
from clothkit.planning import normalisation
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.normalisation import Normalisation
from clothkit.planning.objective import Accuracy, Objective, Term, Weights, objective_of
from clothkit.planning.perception import Estimation, KnownMeshes, ObservedVoxels, Perception
from clothkit.planning.representation import Representation
from clothkit.planning.search import search
from clothkit.planning.settings import PlanConfig
from clothkit.planning.systems import System
from clothkit.planning.types import Found, Problem
from clothkit.planning.uncertainty_terms import Measure, needed, terms_of
from clothkit.planning.voxel_representation import VOXEL
from clothkit.runtime.errors import InputError


@dataclass(frozen=True)
class Planner:
    """A system with everything that an agent needs to decide."""

    system: System
    representation: Representation
    model: ForwardModel
    members: tuple[int, ...]
    """The members of the ensemble whose nets these are."""
    nets: tuple[Any, ...]
    """The weights of each net."""
    best: int
    """Index into `nets` of the one with the best validation score."""
    perception: Perception
    normalisation: Normalisation
    weights: Weights
    settings: PlanConfig
    grasping: CandidateConfig
    labelled: bool = False
    """Whether states have the same labels as their goals, so that a search need not find the relative labelling."""
    accuracy: Accuracy | None = None
    """The accuracy term, if not that of eq. (13)."""
    terms: Mapping[str, Term] = field(default_factory=dict)
    """Further terms of the objective by name, beside those of the paper or, of the same name, instead of them."""

    def objective(self, length: int) -> Objective:
        """What a search for plans of that length minimises.

        Raises InputError when the nets have no reference values for plans of that length.
        """
        objective = objective_of(len(self.nets), self.normalisation.reference(length), self.weights)
        if self.accuracy is not None:
            objective = replace(objective, accuracy=self.accuracy)
        for name, term in self.terms.items():
            objective = objective.with_term(name, term)
        return objective

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


def artifacts(system: System, data: Path, members: Sequence[int], measure: Measure) -> dict[str, Path]:
    """Paths, by name, of the artifacts under `data` that a system needs.

    These are the nets of the ensemble's members (net_0, ..), the reference values (reference), for systems that
    estimate meshes the VtM net (vtm), and what the measure of uncertainty needs (support, expected_error).
    """
    found = {f"net_{member}": path for member, path in folders(data / "nets", system.kind, members).items()}
    found["reference"] = data / f"normalisation/{'voxel' if system.voxels else 'mesh'}.json"
    if system.estimates:
        found["vtm"] = data / "nets/vtm"
    if system.doubts and not system.voxels:
        found |= {name: data / place for name, place in needed(measure).items()}
    return found


def assemble(
    system: System,
    data: Path,
    weights: Weights,
    settings: PlanConfig,
    grasping: CandidateConfig,
    members: Sequence[int],
) -> Planner:
    """Load a system's planner from the artifacts under `data`.

    Raises InputError if one is missing or malformed, and for reference values of another number of nets.
    """
    settings = settings.of(system)
    found = artifacts(system, data, members, settings.uncertainty.measure)
    perception: Perception = ObservedVoxels() if system.voxels else KnownMeshes()
    if system.estimates:
        vtm = store.load(found["vtm"], "vtm")
        perception = Estimation(vtm, settings.refine, refine=system.refine)
    ensemble = load(data / "nets", system.kind, members)
    path = found["reference"]
    reference = normalisation.load(path)
    if len(reference.low) != len(ensemble.nets):
        raise InputError(
            f"{path}: expected reference values of {len(ensemble.nets)} nets, the ensemble's members, found those of "
            f"{len(reference.low)}; run the stage that writes it (dvc repro)"
        )
    if system.single:
        ensemble = Ensemble((ensemble.members[ensemble.best],), (ensemble.best_net,))
    if system.alpha is not None:
        weights = weights._replace(alpha=system.alpha)
    measures = replace(settings.uncertainty, measure="paper") if system.voxels else settings.uncertainty
    if measures.measure == "paper":
        weights = weights._replace(alpha=weights.alpha * measures.u_weight)
    accuracy, terms = terms_of(measures, weights.alpha if system.doubts else 0, ensemble, data)
    return Planner(
        system,
        representation=VOXEL if system.voxels else MESH,
        model=ensemble.model,
        members=ensemble.members,
        nets=ensemble.params,
        best=ensemble.best,
        perception=perception,
        normalisation=reference,
        weights=weights,
        settings=replace(settings, uncertainty=measures),
        grasping=grasping,
        labelled=system.voxels or system.true_meshes,
        accuracy=accuracy,
        terms=terms,
    )
