"""A system with its nets, its eyes and its settings: what sessions are run with."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax

from clothkit.dataset.store import STEPS
from clothkit.manipulation.candidates import CandidateConfig
from clothkit.planning.loss import Weights
from clothkit.planning.normalisation import Normalisation
from clothkit.planning.record import Sizes
from clothkit.planning.search import Found, Problem, search
from clothkit.planning.settings import PlanConfig
from clothkit.planning.sight import Sight
from clothkit.planning.systems import System


@dataclass(frozen=True)
class Planner:
    """A system with all that it plans with."""

    system: System
    sight: Sight
    nets: tuple[Any, ...]
    better: int
    """Which of the nets has the better validation score."""
    normalisation: Normalisation
    weights: Weights
    settings: PlanConfig
    grasping: CandidateConfig

    @property
    def sizes(self) -> Sizes:
        """What sizes a session's record has."""
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
        """The search for plans of one length: problems, keys -> what was found."""
        find = partial(
            search,
            self.sight.forward,
            length=length,
            settings=self.settings.search,
            explicit=float(self.weights.alpha) > 0,
        )
        reference = self.normalisation.reference(length)
        return lambda problems, keys: find(self.nets, problems, reference, self.weights, keys=keys)
