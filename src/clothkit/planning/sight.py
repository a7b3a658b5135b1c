"""How a system sees cloths: as meshes, estimated from voxels or true, or as voxels (sections 5.1 and 6.3).

What a system sees of a state, `[*state]`, is what its forward models encode. A sight is asked for whole batches.
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
from clothkit.networks.net import Net
from clothkit.networks.vtm import seen_by
from clothkit.planning.batches import in_batches
from clothkit.planning.draw import EXTENT, RASTER
from clothkit.planning.forward import MESH, Forward
from clothkit.planning.recorded import Recorded, in_meshes, in_voxels
from clothkit.planning.voxel_forward import VOXEL

CORNERS = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]], np.float32)
"""The cloth's own corners: candidates of a mesh that shows none."""

TOGETHER = 24
"""States that are estimated as one program."""

_observe, _seen_by = jax.jit(voxels.observe), jax.jit(seen_by)
_to_cartesian, _relabel_batch = jax.jit(to_cartesian), jax.jit(relabel_batch)
_distance_aligned, _best_label = jax.jit(distance_aligned), jax.jit(best_label)

Meshes = Float[np.ndarray, "task u v 3"]
States = Shaped[np.ndarray, "task *state"]


class View(NamedTuple):
    """What is seen of cloths, and where."""

    states: States
    shift: Float[np.ndarray, "task 2"]
    """From their true centres to those that were observed [normalised]."""


@runtime_checkable
class Sight(Protocol):
    """What planning needs of a representation, beside a forward model."""

    @property
    def forward(self) -> Forward:
        """How states are encoded, predicted and compared."""
        ...

    @property
    def shape(self) -> tuple[int, ...]:
        """*state."""
        ...

    @property
    def labelled(self) -> bool:
        """Whether states come in the labels of their goals, so that none have to be found."""
        ...

    def see(self, truth: Meshes, expected: States | None) -> View:
        """What is seen of true, centred states; `expected` are the means that were predicted for them."""
        ...

    def goals(self, meshes: Meshes) -> States:
        """Goals as the system is given them."""
        ...

    def grasps(self, state: Shaped[np.ndarray, "*state"], settings: CandidateConfig) -> Float[np.ndarray, "c 2"]:
        """Candidates, as the nets take grasp points."""
        ...

    def covered(self, state: Shaped[np.ndarray, "*state"]) -> Bool[np.ndarray, "x y"]:
        """What a state covers, seen from above, for `draw.folds`."""
        ...

    def places(self, states: States, grasps: Float[np.ndarray, "task 2 2"]) -> Float[np.ndarray, "task 2 2"]:
        """Where grasp points lie, xy from the observed centre [normalised]."""
        ...

    def relabelled(self, states: States, k: Int[np.ndarray, " task"]) -> States:
        """States under other labels."""
        ...

    def means(self, predictions: Any) -> Float[np.ndarray, "task n *state"]:
        """What predictions say, without how sure they are."""
        ...

    def misses(self, states: States, goals: States) -> Float[np.ndarray, " task"]:
        """How far states are from goals, by what the planner sees: for the null check (section 5.1)."""
        ...

    def refined(self, outcomes: Any) -> Meshes | None:
        """Plausible meshes of predicted outcomes, for pictures."""
        ...

    def recorded(self, states: Float[np.ndarray, "task state u v 3"], plan: Float[np.ndarray, "task n 6"]) -> Recorded:
        """Recorded manipulations as the nets take them, in the dataset's labels."""
        ...

    def labels(self, seen: States, truth: Meshes) -> Int[np.ndarray, " task"]:
        """The relabellings that bring true states under the labels of what is seen. Privileged: for diagnosis alone."""
        ...


@dataclass(frozen=True)
class MeshSight:
    """Meshes: refined estimates of what a camera sees, or the truth where there is no `vtm`."""

    vtm: Net | None
    refinement: RefineConfig
    refine: bool = True
    """Without it estimates are VtM's means, under the labels that fit the prediction best (section 4.7)."""
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
        """The meshes that voxels show."""
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
    """Voxels, as a camera above sees them: doubled, occluded, free of noise."""

    forward: Forward = VOXEL
    shape: tuple[int, ...] = voxels.RESOLUTION
    labelled: bool = True
    """One labelling is all that there are."""

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
    """Geodesic grasp points of a mesh (section 4.3); the cloth's corners if its silhouette shows none."""
    xy = candidates(mesh, settings)
    uv = to_geodesic(mesh, xy) if len(xy) else CORNERS
    distinct = np.sort(np.unique(uv, axis=0, return_index=True)[1])
    return uv[distinct][: settings.most].astype(np.float32)
