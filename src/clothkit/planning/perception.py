"""Perception: from an observation to the state that a planner plans from (sections 4.7 and 5.1)."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Float, Shaped

from clothkit.cloth.mesh import ProbabilisticMesh, best_label, mean_sigma
from clothkit.cloth.silhouette import centred
from clothkit.cloth.symmetry import relabel
from clothkit.cloth.voxels import VIEWPORT, Viewport
from clothkit.estimation.estimate import estimate, estimate_probabilistic, estimate_unrefined, with_prediction
from clothkit.estimation.refine import RefineConfig
from clothkit.models.net import Net
from clothkit.planning.batches import in_batches
from clothkit.planning.types import Meshes, Observation, States
from clothkit.runtime.clock import timed


class Expected(NamedTuple):
    """Predictions of the states that are observed."""

    mean: States
    std: States
    """Infinite where not known."""


@runtime_checkable
class Perception(Protocol):
    """What turns observations of a batch of cloths into states of a planner's representation."""

    @property
    def viewport(self) -> Viewport | None:
        """The viewport of the voxels that it takes; None if it takes meshes."""
        ...

    def __call__(
        self, observation: Observation, expected: Expected | None, cloth: Float[np.ndarray, "task 3"]
    ) -> States:
        """The states; `expected` are the predictions of these states, None if nothing was predicted yet.

        `cloth` are the cloths' sides and thicknesses.
        """
        ...


@runtime_checkable
class Unsure(Protocol):
    """A perception that tells how unsure it is."""

    def probabilistic(
        self, observation: Observation, states: Meshes, expected: Expected | None, cloth: Float[np.ndarray, "task 3"]
    ) -> ProbabilisticMesh:
        """What it knows of the states that it took the observation for, in their labels [normalised].

        `expected` are the predictions that it took into account, if any.
        """
        ...


def stds_of(
    perception: Perception,
    observation: Observation,
    states: States,
    expected: Expected | None,
    cloth: Float[np.ndarray, "task 3"],
) -> Meshes | None:
    """The standard deviations of the states that a perception took an observation for, in their labels [normalised].

    None if the perception does not tell, or takes what it observes. `expected` are the predictions that it took into
    account, if any.
    """
    if not isinstance(perception, Unsure):
        return None
    return np.asarray(perception.probabilistic(observation, states, expected, cloth).std)


def sigma_of(states: States, stds: Meshes | None) -> Float[np.ndarray, " task"]:
    """How unsure a perception is of states with these standard deviations [cloth length]; 0 without any.

    This is the root of the mean predicted variance of a vertex.
    """
    if stds is None:
        return np.zeros(len(states), np.float32)
    return np.asarray(mean_sigma(ProbabilisticMesh(states, stds)))


@dataclass(frozen=True)
class Estimation:
    """Meshes are estimated from voxels by VtM and refined."""

    vtm: Net
    refinement: RefineConfig
    refine: bool = True
    """If False, estimates are VtM's means, in the labels that fit the prediction best (section 4.7)."""
    batch: int = 24
    """Number of cloths that are estimated in one call."""

    @property
    def viewport(self) -> Viewport:
        return self.vtm.config.viewport

    def __call__(
        self, observation: Observation, expected: Expected | None, cloth: Float[np.ndarray, "task 3"]
    ) -> Meshes:
        assert observation.voxels is not None, "an observation to estimate from has voxels"

        def meshes(voxels: np.ndarray, cloth: np.ndarray, *expected: np.ndarray) -> jax.Array:
            predicted = ProbabilisticMesh(*expected) if expected else None
            if not self.refine:
                return estimate_unrefined(self.vtm, voxels, predicted and predicted.mean, cloth=cloth)
            return estimate(self.vtm, voxels, self.refinement, predicted=predicted, cloth=cloth).mesh

        # The last batch is padded; its copies count, because they take as long.
        with timed("estimates", -(-len(observation.voxels) // self.batch) * self.batch):
            inputs = (observation.voxels, cloth, *(() if expected is None else as_observed(expected)))
            return in_batches(meshes, self.batch, *inputs)

    def probabilistic(
        self, observation: Observation, states: Meshes, expected: Expected | None, cloth: Float[np.ndarray, "task 3"]
    ) -> ProbabilisticMesh:
        """VtM's meshes that the states were refined from; of several hypotheses, those nearest to the states."""
        assert observation.voxels is not None, "an observation to estimate from has voxels"

        def found(
            voxels: np.ndarray, states: np.ndarray, cloth: np.ndarray, *expected: np.ndarray
        ) -> ProbabilisticMesh:
            if not expected or not self.refine:
                return estimate_probabilistic(self.vtm, voxels, states, cloth=cloth)
            return with_prediction(self.vtm, voxels, self.refinement, ProbabilisticMesh(*expected), cloth=cloth)

        inputs = (observation.voxels, states, cloth, *(() if expected is None else as_observed(expected)))
        return in_batches(found, self.batch, *inputs)


@dataclass(frozen=True)
class KnownMeshes:
    """The observed meshes are the states."""

    labelled: bool = True
    """Whether their labels are those of the goal and stay the same. Else they follow the expected mesh's."""
    viewport: None = None

    def __call__(
        self, observation: Observation, expected: Expected | None, cloth: Float[np.ndarray, "task 3"]
    ) -> Meshes:
        assert observation.meshes is not None, "an observation that is planned from as it is has meshes"
        if self.labelled or expected is None:
            return observation.meshes
        return np.stack([labelled_like(*each) for each in zip(observation.meshes, expected.mean, cloth, strict=True)])


@dataclass(frozen=True)
class ObservedVoxels:
    """The observed voxels are the states."""

    viewport: Viewport = VIEWPORT

    def __call__(
        self, observation: Observation, expected: Expected | None, cloth: Float[np.ndarray, "task 3"]
    ) -> States:
        assert observation.voxels is not None, "an observation that is planned from as it is has voxels"
        return observation.voxels


def as_observed(expected: Expected) -> Expected:
    """Predicted meshes, centred as observations are."""
    return expected._replace(mean=np.stack([centred(mesh)[0] for mesh in expected.mean]).astype(np.float32))


def labelled_like(
    mesh: Shaped[np.ndarray, "u v 3"], expected: Shaped[np.ndarray, "u v 3"], cloth: Float[np.ndarray, "3"]
) -> np.ndarray:
    """The Cartesian equivalent of a mesh that is nearest to `expected`, among those that keep the cloth's sides."""
    return np.asarray(relabel(mesh, best_label(expected.astype(np.float32), mesh, aligned=True, cloth=cloth)))
