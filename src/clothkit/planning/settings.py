"""Settings of the normalise and plan stages."""

import dataclasses
from typing import Annotated

from annotated_types import Ge, Gt, MinLen

from clothkit.estimation.refine import RefineConfig
from clothkit.planning.search import SearchConfig
from clothkit.planning.systems import SYSTEMS, System
from clothkit.planning.uncertainty_terms import UncertaintyConfig
from clothkit.runtime.config import config

Count = Annotated[int, Gt(0)]
Seed = Annotated[int, Ge(0)]


@config
class NormaliseConfig:
    """Settings of the reference values of eqs. (14) and (15)."""

    draws: Count = 8
    """Random plans per validation task, from which high of eq. (14) is computed."""
    seed: Seed = 0


@config
class PlanConfig:
    """Settings of the plan stages: number of sequences, search and refinement."""

    test: Count = 100
    """Number of test sequences; sessions are run for all tasks of each."""
    train: Annotated[int, Ge(0)] = 100
    """Number of training sequences; sessions are run for all tasks of each."""
    systems: Annotated[tuple[str, ...], MinLen(1)] = tuple(SYSTEMS)
    """Systems that plan. The plan stages of the others write that they were left out."""
    search: SearchConfig = SearchConfig()
    refine: RefineConfig = RefineConfig()
    uncertainty: UncertaintyConfig = UncertaintyConfig()
    together: Count = 4
    """Sequences whose sessions run in parallel. An interrupted run loses the unfinished sessions of so many at most."""
    batch: Count = 4
    """Searches that run in parallel. Sequences of full length need no padding if `together` is a multiple of it."""
    seed: Seed = 0
    voxel_search: SearchConfig = SearchConfig()
    """Used instead of `search` by systems that plan in voxels, where a strain costs many times as much."""
    voxel_batch: Count = 1
    """Used instead of `batch` by systems that plan in voxels."""

    def __post_init__(self) -> None:
        if unknown := [system for system in self.systems if system not in SYSTEMS]:
            raise ValueError(f"systems has {unknown[0]!r}, expected some of {', '.join(SYSTEMS)}")
        # Voxels have no edge and are never thinned: such a setting would have no effect, or a wrong one.
        if self.voxel_search.edge != 0 or self.voxel_search.stride != 1:
            raise ValueError("voxel_search: expected edge 0 and stride 1, which concern meshes alone")

    def of(self, system: System) -> "PlanConfig":
        """The settings of a system: if it plans in voxels, `search` and `batch` are those for voxels."""
        if not system.voxels:
            return self
        return dataclasses.replace(self, search=self.voxel_search, batch=self.voxel_batch)
