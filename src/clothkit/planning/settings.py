"""Settings of the normalise and plan stages."""

import dataclasses
from typing import Annotated

from annotated_types import Ge, Gt

from clothkit.config import config
from clothkit.estimation.refine import RefineConfig
from clothkit.planning.search import SearchConfig
from clothkit.planning.systems import System

Count = Annotated[int, Gt(0)]
Seed = Annotated[int, Ge(0)]


@config
class NormaliseConfig:
    """How the reference values of eqs. (14) and (15) are computed."""

    draws: Count = 8
    """Random plans per validation task, for high."""
    seed: Seed = 0


@config
class PlanConfig:
    """How many sequences are planned for, and how."""

    test: Count = 100
    """Test sequences, all six tasks of each."""
    train: Annotated[int, Ge(0)] = 100
    """Training sequences, likewise."""
    search: SearchConfig = SearchConfig()
    refine: RefineConfig = RefineConfig()
    together: Count = 4
    """Sequences whose sessions run side by side: what an interrupted run may lose."""
    batch: Count = 4
    """Searches that run as one program. With `together` a multiple of it, none is filled up in vain."""
    seed: Seed = 0
    voxel_search: SearchConfig = SearchConfig()
    """The search of systems that plan in voxels, where a strain costs many times as much."""
    voxel_batch: Count = 1
    """Likewise in place of `batch`."""

    def of(self, system: System) -> "PlanConfig":
        """The settings of a system: those for voxels in place of the others, if it sees voxels."""
        if not system.voxels:
            return self
        return dataclasses.replace(self, search=self.voxel_search, batch=self.voxel_batch)
