"""Planning in voxels, for baselines B4 and B5: states of the voxel EM*D (section 6.3, design 6.15)."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from clothkit.cloth import voxels
from clothkit.cloth.silhouette import pixel_centres
from clothkit.manipulation.candidates import CandidateConfig, voxel_candidates
from clothkit.models import emd_voxel
from clothkit.models.emd_voxel import cross_entropy
from clothkit.planning.batches import BATCH, in_batches
from clothkit.planning.initial import EXTENT, RASTER
from clothkit.planning.representation import Recorded
from clothkit.planning.types import Meshes, States

Logits = Float[Array, "*batch x y z"]


@dataclass(frozen=True)
class VoxelRepresentation:
    """Voxels as a camera above the table sees them; predictions are the logits of their occupancy.

    Voxels have no labels and are not whitened. Grasp points are Cartesian [normalised], relative to the centre of the
    state that is manipulated.
    """

    shape: tuple[int, ...] = voxels.RESOLUTION
    labels: int = 1
    probabilistic: bool = False

    def equivalents(self, state: Shaped[Array, "x y z"]) -> Shaped[Array, "1 x y z"]:
        return jnp.asarray(state)[None]

    def relabel_prediction(self, prediction: Logits, k: Int[Array, ""]) -> Logits:
        return prediction

    def points(
        self, state: Shaped[Array | np.ndarray, "x y z"], grasps: Float[Array, "*points 2"]
    ) -> Float[Array, "*points 2"]:
        return grasps

    def target(self, goals: Shaped[Array, "*goals x y z"]) -> Float[Array, "*goals x y z"]:
        return jnp.asarray(goals, jnp.float32)

    def thinned(self, goals: Shaped[Array, "*goals x y z"], stride: int) -> Shaped[Array, "*goals x y z"]:
        """The goals as they are: losses always compare all voxels."""
        return goals

    def accuracy(self, target: Float[Array, "*#batch x y z"], outcome: Logits) -> Float[Array, "*batch"]:
        """The binary cross-entropy, in place of the NLL of eq. (13)."""
        return cross_entropy(outcome, target)

    def accuracy_of_each(self, targets: Float[Array, "goals x y z"], outcome: Logits) -> Float[Array, "strains goals"]:
        return jnp.stack([self.accuracy(target, outcome) for target in targets], axis=-1)

    def difference(self, a: Logits, b: Logits) -> Float[Array, "*batch"]:
        """The mean squared difference of the predicted occupancies."""
        return jnp.mean((jax.nn.sigmoid(a) - jax.nn.sigmoid(b)) ** 2, axis=(-3, -2, -1))

    def relabel(self, states: States, k: Int[np.ndarray, " task"]) -> States:
        return states

    def positions(self, states: States, grasps: Float[np.ndarray, "task 2 2"]) -> Float[np.ndarray, "task 2 2"]:
        return grasps

    def mean(self, prediction: Float[Array | np.ndarray, "*batch x y z"]) -> Float[np.ndarray, "*batch x y z"]:
        return np.asarray(jax.nn.sigmoid(prediction))

    def std(self, prediction: Float[Array | np.ndarray, "*batch x y z"]) -> None:
        return None

    def distance(self, states: States, goals: States) -> Float[np.ndarray, " task"]:
        return np.abs(states.astype(np.float32) - goals).mean((-3, -2, -1))

    def of_meshes(self, meshes: Meshes) -> States:
        return in_batches(_observe, BATCH, meshes)

    def recorded(self, states: Float[np.ndarray, "task state u v 3"], plan: Float[np.ndarray, "task n 6"]) -> Recorded:
        start, goal = (self.of_meshes(states[:, i]) for i in (0, -1))
        return Recorded(start, in_batches(_cartesian, BATCH, states[:, :-1], plan), goal)

    def candidates(
        self, state: Shaped[np.ndarray, "x y z"], settings: CandidateConfig
    ) -> Float[np.ndarray, "candidates 2"]:
        return voxel_candidates(state > 0, settings)

    def covered(self, state: Shaped[np.ndarray, "x y z"]) -> Bool[np.ndarray, "raster raster"]:
        columns = np.asarray((state > 0).any(-1))
        column = np.floor((pixel_centres(RASTER, EXTENT) + 1) / 2 * len(columns)).astype(int)
        inside = (column >= 0) & (column < len(columns))
        return np.where(inside[:, None] & inside, columns[np.ix_(column % len(columns), column % len(columns))], False)


VOXEL = VoxelRepresentation()

_observe, _cartesian = jax.jit(voxels.observe), jax.jit(emd_voxel.cartesian)
