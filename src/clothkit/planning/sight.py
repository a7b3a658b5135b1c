"""Observation models: a system's states are meshes, estimated from voxels or true, or voxels (sections 5.1 and 6.3).

A state in a system's representation, of shape `*state`, is the input of its forward models. Most methods take batches.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from clothkit.cloth import voxels
from clothkit.cloth.equivalents import relabel_batch
from clothkit.cloth.grid import SIDE
from clothkit.cloth.mesh import ProbabilisticMesh, best_label, distance_aligned
from clothkit.cloth.silhouette import pixel_centres, silhouette
from clothkit.estimation.estimate import estimate, estimate_unrefined
from clothkit.estimation.refine import RefineConfig, refine
from clothkit.manipulation.candidates import CandidateConfig, candidates, voxel_candidates
from clothkit.manipulation.geometry import to_cartesian, to_geodesic
from clothkit.models.net import Net
from clothkit.models.vtm import seen_by
from clothkit.planning.batches import in_batches
from clothkit.planning.draw import EXTENT, RASTER
from clothkit.planning.forward import MESH, Forward
from clothkit.planning.recorded import Recorded, in_meshes, in_voxels
from clothkit.planning.voxel_forward import VOXEL

CORNERS = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]], np.float32)
"""Geodesic coordinates of the cloth's corners: the candidates if no corner is detected in a silhouette."""

TOGETHER = 24
"""Batch size of estimation and refinement."""

_observe, _seen_by = jax.jit(voxels.observe), jax.jit(seen_by)
_to_cartesian, _relabel_batch = jax.jit(to_cartesian), jax.jit(relabel_batch)
_distance_aligned, _best_label = jax.jit(distance_aligned), jax.jit(best_label)

Meshes = Float[np.ndarray, "task u v 3"]
States = Shaped[np.ndarray, "task *state"]


class View(NamedTuple):
    """Observed states and the errors of their observed centres."""

    states: States
    shift: Float[np.ndarray, "task 2"]
    """Vectors from the true centres to the observed ones [normalised]."""


@runtime_checkable
class Sight(Protocol):
    """A representation of states: how they are observed, labelled and compared, together with a forward model."""

    @property
    def forward(self) -> Forward:
        """The forward model's functions for this representation."""
        ...

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of one state, `*state`."""
        ...

    @property
    def labelled(self) -> bool:
        """Whether states have the same labels as their goals, so that a search need not find the relative labelling."""
        ...

    def see(self, truth: Meshes, expected: States | None) -> View:
        """Observe true, centred states; `expected` are the predicted means of these states, None at the first step."""
        ...

    def goals(self, meshes: Meshes) -> States:
        """Goal meshes converted to this representation."""
        ...

    def grasps(self, state: Shaped[np.ndarray, "*state"], settings: CandidateConfig) -> Float[np.ndarray, "c 2"]:
        """Candidate grasp points on one state, in the coordinates of the nets' inputs."""
        ...

    def covered(self, state: Shaped[np.ndarray, "*state"]) -> Bool[np.ndarray, "x y"]:
        """Mask of the area that one state covers, seen from above, as `draw.folds` takes it."""
        ...

    def places(self, states: States, grasps: Float[np.ndarray, "task 2 2"]) -> Float[np.ndarray, "task 2 2"]:
        """Positions of grasp points on the states, xy relative to the observed centre [normalised]."""
        ...

    def relabelled(self, states: States, k: Int[np.ndarray, " task"]) -> States:
        """The states, each under the labels of equivalent k."""
        ...

    def means(self, predictions: Any) -> Float[np.ndarray, "task n *state"]:
        """The means of predictions, without their standard deviations; for voxels, the predicted occupancy 0..1."""
        ...

    def misses(self, states: States, goals: States) -> Float[np.ndarray, " task"]:
        """Distance of each state from its goal, for the null check (section 5.1).

        For meshes it is aligned [cloth length], for voxels it is the mean absolute difference.
        """
        ...

    def refined(self, outcomes: Any) -> Meshes | None:
        """Predicted outcomes, refined to plausible meshes; None for voxels. Used for figures only."""
        ...

    def recorded(self, states: Float[np.ndarray, "task state u v 3"], plan: Float[np.ndarray, "task n 6"]) -> Recorded:
        """Recorded manipulations as inputs of the nets, in the dataset's labels."""
        ...

    def labels(self, seen: States, truth: Meshes) -> Int[np.ndarray, " task"]:
        """Relabellings k that bring true states to the labels of the observed ones.

        Uses the truth, so this is for diagnosis only.
        """
        ...


@dataclass(frozen=True)
class MeshSight:
    """States are meshes: refined estimates from voxels, or the true meshes if `vtm` is None."""

    vtm: Net | None
    refinement: RefineConfig
    refine: bool = True
    """If False, estimates are VtM's means, in the labels that fit the prediction best (section 4.7)."""
    forward: Forward = MESH
    shape: tuple[int, ...] = (SIDE, SIDE, 3)

    @property
    def labelled(self) -> bool:
        return self.vtm is None

    def see(self, truth: Meshes, expected: States | None) -> View:
        if self.vtm is None:
            return _well_centred(truth)
        return _well_centred(self.estimates(np.asarray(_seen_by(self.vtm, truth)), expected))

    def estimates(self, seen: Shaped[np.ndarray, "task x y z"], expected: Meshes | None) -> Meshes:
        """Estimate meshes from voxels; `expected` as in `Sight.see`."""
        assert self.vtm is not None, "a sight that estimates has a net for it"
        vtm, settings = self.vtm, self.refinement
        if not self.refine:
            return in_batches(lambda *given: estimate_unrefined(vtm, *given), TOGETHER, seen, *_if_given(expected))

        def refined(seen: np.ndarray, *predicted: np.ndarray) -> jax.Array:
            return estimate(vtm, seen, settings, predicted=predicted[0] if predicted else None).mesh

        return in_batches(refined, TOGETHER, seen, *_if_given(expected))

    def goals(self, meshes: Meshes) -> States:
        return meshes

    def grasps(self, state: np.ndarray, settings: CandidateConfig) -> np.ndarray:
        return mesh_candidates(state, settings)

    def covered(self, state: np.ndarray) -> np.ndarray:
        return silhouette(state, resolution=RASTER, extent=EXTENT)

    def places(self, states: States, grasps: np.ndarray) -> np.ndarray:
        believed = np.repeat(states[:, None], 2, axis=1)
        return np.asarray(_to_cartesian(believed, grasps))[..., :2]

    def relabelled(self, states: States, k: np.ndarray) -> States:
        return np.asarray(_relabel_batch(states, k))

    def means(self, predictions: ProbabilisticMesh) -> np.ndarray:
        return np.asarray(predictions.mean)

    def misses(self, states: States, goals: States) -> np.ndarray:
        return np.asarray(_distance_aligned(states, goals))

    def refined(self, outcomes: ProbabilisticMesh) -> Meshes:
        return in_batches(lambda outcome: refine(outcome, outcome.mean, self.refinement), TOGETHER, outcomes)

    def recorded(self, states: np.ndarray, plan: np.ndarray) -> Recorded:
        return in_meshes(states, plan)

    def labels(self, seen: States, truth: Meshes) -> np.ndarray:
        return np.asarray(_best_label(seen, truth))


@dataclass(frozen=True)
class VoxelSight:
    """States are voxels as a camera above the table sees them: doubled, occluded and without noise."""

    forward: Forward = VOXEL
    shape: tuple[int, ...] = voxels.RESOLUTION
    labelled: bool = True
    """Voxels have a single labelling."""

    def see(self, truth: Meshes, expected: States | None) -> View:
        return _well_centred(np.asarray(_observe(truth)))

    def goals(self, meshes: Meshes) -> States:
        return np.asarray(_observe(meshes))

    def grasps(self, state: np.ndarray, settings: CandidateConfig) -> np.ndarray:
        return voxel_candidates(state > 0, settings)

    def covered(self, state: np.ndarray) -> np.ndarray:
        columns = np.asarray((state > 0).any(-1))
        column = np.floor((pixel_centres(RASTER, EXTENT) + 1) / 2 * len(columns)).astype(int)
        inside = (column >= 0) & (column < len(columns))
        return np.where(inside[:, None] & inside, columns[np.ix_(column % len(columns), column % len(columns))], False)

    def places(self, states: States, grasps: np.ndarray) -> np.ndarray:
        return grasps

    def relabelled(self, states: States, k: np.ndarray) -> States:
        return states

    def means(self, predictions: Any) -> np.ndarray:
        return np.asarray(jax.nn.sigmoid(predictions))

    def misses(self, states: States, goals: States) -> np.ndarray:
        return np.abs(states.astype(np.float32) - goals).mean((-3, -2, -1))

    def refined(self, outcomes: Any) -> None:
        return None

    def recorded(self, states: np.ndarray, plan: np.ndarray) -> Recorded:
        return in_voxels(states, plan)

    def labels(self, seen: States, truth: Meshes) -> np.ndarray:
        return np.zeros(len(seen), np.int64)


def _well_centred(states: States) -> View:
    return View(states, np.zeros((len(states), 2), np.float32))


def _if_given(expected: np.ndarray | None) -> tuple[np.ndarray, ...]:
    return () if expected is None else (expected,)


def mesh_candidates(mesh: Float[np.ndarray, "u v 3"], settings: CandidateConfig) -> Float[np.ndarray, "candidates 2"]:
    """Candidate grasp points of a mesh, geodesic (section 4.3); the cloth's corners if its silhouette has no corner."""
    xy = candidates(mesh, settings)
    uv = to_geodesic(mesh, xy) if len(xy) else CORNERS
    distinct = np.sort(np.unique(uv, axis=0, return_index=True)[1])
    return uv[distinct][: settings.most].astype(np.float32)
