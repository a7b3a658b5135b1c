"""Planning in meshes: states are meshes of labelled vertices, predictions probabilistic meshes (section 5.1)."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped

from clothkit.cloth import symmetry, topology
from clothkit.cloth.mesh import ProbabilisticMesh, distance_aligned, nll, whiten, whiten_probabilistic
from clothkit.cloth.silhouette import silhouette
from clothkit.cloth.symmetry import relabel_batch
from clothkit.cloth.topology import SQUARE
from clothkit.manipulation.candidates import CandidateConfig, candidates
from clothkit.manipulation.geometry import to_cartesian, to_geodesic
from clothkit.planning.batches import BATCH, in_batches
from clothkit.planning.initial import EXTENT, RASTER
from clothkit.planning.representation import Recorded
from clothkit.planning.types import Meshes, States

CORNERS = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]], np.float32)
"""Geodesic coordinates of the cloth's corners: the candidates if no corner is detected in a silhouette."""


@dataclass(frozen=True)
class MeshRepresentation:
    """Meshes [u v 3], normalised and centred, in any of their labellings; grasp points are geodesic."""

    shape: tuple[int, ...] = (*SQUARE.shape, 3)
    labels: int = SQUARE.count
    probabilistic: bool = True

    def equivalents(self, state: Float[Array, "u v 3"]) -> Float[Array, "8 u v 3"]:
        return symmetry.equivalents(state)

    def relabel_prediction(self, prediction: ProbabilisticMesh, k: Int[Array, ""]) -> ProbabilisticMesh:
        return ProbabilisticMesh(*(symmetry.relabel(part, k) for part in prediction))

    def points(
        self, state: Float[Array | np.ndarray, "u v 3"], grasps: Float[Array, "*points 2"]
    ) -> Float[Array, "*points 2"]:
        return to_cartesian(jnp.broadcast_to(state, (*grasps.shape[:-1], *state.shape)), grasps)[..., :2]

    def target(self, goals: Float[Array, "*goals u v 3"]) -> Float[Array, "*goals u v 3"]:
        return whiten(goals)

    def thinned(self, goals: Float[Array, "*goals u v 3"], stride: int) -> Float[Array, "*goals thin_u thin_v 3"]:
        return topology.thinned(goals, stride)

    def accuracy(self, target: Float[Array, "*batch u v 3"], outcome: ProbabilisticMesh) -> Float[Array, "*batch"]:
        """The NLL of eq. (13). Targets are whitened already, since they do not change during a search."""
        return nll(target, whiten_probabilistic(outcome))

    def accuracy_of_each(
        self, targets: Float[Array, "goals u v 3"], outcome: ProbabilisticMesh
    ) -> Float[Array, "strains goals"]:
        """The squared differences are expanded, so that two matrix products compute all pairs."""
        outcome = whiten_probabilistic(outcome)
        count = len(outcome.std)
        precision = 1 / jnp.asarray(outcome.std).reshape(count, -1) ** 2
        mean, flat = jnp.asarray(outcome.mean).reshape(count, -1), targets.reshape(len(targets), -1)
        squares = (
            precision @ (flat**2).T - 2 * (mean * precision) @ flat.T + jnp.sum(mean**2 * precision, 1, keepdims=True)
        )
        constant = 0.5 * jnp.log(2 * jnp.pi) - 0.5 * jnp.mean(jnp.log(precision), axis=1, keepdims=True)
        return 0.5 * squares / flat.shape[1] + constant

    def difference(self, a: ProbabilisticMesh, b: ProbabilisticMesh) -> Float[Array, "*batch"]:
        """The mean squared difference of two predictions over all six channels, whitened."""
        a, b = whiten_probabilistic(a), whiten_probabilistic(b)
        # Half of the mean of the sum is the mean over all six channels.
        squared = (a.mean - b.mean) ** 2 + (a.std - b.std) ** 2
        return jnp.mean(squared, axis=(-3, -2, -1)) / 2

    def relabel(self, states: States, k: Int[np.ndarray, " task"]) -> States:
        return in_batches(_relabel_batch, BATCH, states, k)

    def positions(self, states: States, grasps: Float[np.ndarray, "task 2 2"]) -> Float[np.ndarray, "task 2 2"]:
        return in_batches(_to_cartesian, BATCH, np.repeat(states[:, None], 2, axis=1), grasps)[..., :2]

    def mean(self, prediction: ProbabilisticMesh) -> Float[np.ndarray, "*batch u v 3"]:
        return np.asarray(prediction.mean)

    def std(self, prediction: ProbabilisticMesh) -> Float[np.ndarray, "*batch u v 3"]:
        return np.asarray(prediction.std)

    def distance(self, states: States, goals: States) -> Float[np.ndarray, " task"]:
        return in_batches(_distance_aligned, BATCH, states, goals)

    def of_meshes(self, meshes: Meshes) -> States:
        return meshes

    def recorded(self, states: Float[np.ndarray, "task state u v 3"], plan: Float[np.ndarray, "task n 6"]) -> Recorded:
        return Recorded(states[:, 0], plan, states[:, -1])

    def candidates(
        self, state: Shaped[np.ndarray, "u v 3"], settings: CandidateConfig
    ) -> Float[np.ndarray, "candidates 2"]:
        """The corners of the silhouette (section 4.3); the cloth's own corners if there is none."""
        xy = candidates(state, settings)
        uv = to_geodesic(state, xy) if len(xy) else CORNERS
        distinct = np.sort(np.unique(uv, axis=0, return_index=True)[1])
        return uv[distinct][: settings.most].astype(np.float32)

    def covered(self, state: Shaped[np.ndarray, "u v 3"]) -> np.ndarray:
        return silhouette(state, resolution=RASTER, extent=EXTENT)


MESH = MeshRepresentation()

_to_cartesian, _relabel_batch, _distance_aligned = (
    jax.jit(to_cartesian),
    jax.jit(relabel_batch),
    jax.jit(distance_aligned),
)
