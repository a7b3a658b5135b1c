"""VtM, the voxel-to-mesh net: seven fully connected layers, probabilistic output (section 4.7, design 6.3)."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import flax.linen as nn
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, PyTree, Shaped
from numpy import ndarray

from clothkit.cloth.mesh import Cloth, Mesh, ProbabilisticMesh, best_label
from clothkit.cloth.symmetry import equivalents, relabel
from clothkit.cloth.topology import PAPERS_CLOTH, SQUARE, SWAP
from clothkit.cloth.voxels import RESOLUTION, observe
from clothkit.manipulation.turns import turn_mesh
from clothkit.models.canonical import axes, lies_along_y
from clothkit.models.layers import dense, probabilistic_mesh, probabilistic_output, run, with_cloth
from clothkit.models.net import Net
from clothkit.models.settings import Start, VtMConfig

HIDDEN_LAYERS = 5


class VtM(nn.Module):
    """Five hidden layers with tanh, and the output of eq. (6); `start` affects the initial weights only."""

    config: VtMConfig
    start: Start = Start()

    @nn.compact
    def __call__(self, voxels: Shaped[Array, "*batch x y z"], cloth: Cloth = PAPERS_CLOTH) -> ProbabilisticMesh:
        units = voxels.reshape(*voxels.shape[:-3], -1).astype(jnp.float32)
        if self.config.told:
            units = with_cloth(units, cloth)
        for i in range(HIDDEN_LAYERS):
            units = jnp.tanh(dense(self.config.hidden, f"layer_{i + 1}")(units))
        return probabilistic_mesh(probabilistic_output("mesh", self.start)(units), self.config.least_std)


def initial(config: VtMConfig, start: Start = Start(), *, key: PRNGKeyArray) -> PyTree:  # noqa: B008
    """Initial weights for training."""
    return VtM(config, start).init(key, jnp.zeros(RESOLUTION))["params"]


def seen_by(net: Net, mesh: Float[Array | ndarray, "*batch u v 3"]) -> Bool[Array, "*batch 32 32 16"]:
    """The net's input voxels for meshes: the output of `voxels.observe` in the net's viewport."""
    return observe(mesh, viewport=net.config.viewport)


@runtime_checkable
class Estimator(Protocol):
    """VtM as a pure function of a net's weights."""

    def __call__(
        self, params: PyTree, voxels: Shaped[Array, "*batch 32 32 16"], cloth: Cloth = PAPERS_CLOTH
    ) -> ProbabilisticMesh:
        """The probabilistic mesh [normalised] of centred, occluded voxels (bool or 0 / 1): eq. (9).

        `cloth` are the cloth's sides and thickness, for nets that are told them.
        """
        ...


@dataclass(frozen=True)
class SinglePass:
    """An estimate is the net's output."""

    config: VtMConfig

    def __call__(
        self, params: PyTree, voxels: Shaped[Array, "*batch 32 32 16"], cloth: Cloth = PAPERS_CLOTH
    ) -> ProbabilisticMesh:
        return run(VtM(self.config), params, voxels, jnp.asarray(cloth))


@dataclass(frozen=True)
class Canonicalised:
    """An `Estimator` that shows another one only voxels that are widest along x."""

    estimator: Estimator

    def __call__(
        self, params: PyTree, voxels: Shaped[Array, "*batch 32 32 16"], cloth: Cloth = PAPERS_CLOTH
    ) -> ProbabilisticMesh:
        swap = lies_along_y(voxels) * SWAP
        return back(self.estimator(params, relabel(voxels, swap[..., None, None, None]), cloth), swap)


@dataclass(frozen=True)
class Views:
    """An `Estimator` that combines another one's estimates of the voxels, rotated by right angles and mirrored.

    Each estimate is transformed back and relabelled to be nearest to the first one; the result has the mean and
    standard deviation of their mixture. This averages out errors that depend on the orientation.
    """

    estimator: Estimator
    equivalents: tuple[int, ...]
    """The transformations of the axes x and y, as those of u and v by equivalent k."""

    def __call__(
        self, params: PyTree, voxels: Shaped[Array, "*batch 32 32 16"], cloth: Cloth = PAPERS_CLOTH
    ) -> ProbabilisticMesh:
        views = [back(self.estimator(params, relabel(voxels, k), cloth), k) for k in self.equivalents]
        first = views[0].mean
        labelled = [(relabelled_like(m, first, m, cloth), relabelled_like(s, first, m, cloth)) for m, s in views]
        means, stds = (jnp.stack(parts) for parts in zip(*labelled, strict=True))
        mean = jnp.mean(means, axis=0)
        return ProbabilisticMesh(mean, jnp.sqrt(jnp.mean(stds**2 + (means - mean) ** 2, axis=0)))


def estimator(config: VtMConfig) -> Estimator:
    """The estimator that a net with this configuration was trained for."""
    single = SinglePass(config)
    shown = Canonicalised(single) if config.canonical else single
    if config.views == 1:
        return shown
    # A canonical net's estimates do not change when x and y are swapped: four of the eight views differ.
    views = (k for k in range(SQUARE.count) if not (config.canonical and k & SWAP))
    return Views(shown, tuple(views))


def estimate(
    net: Net, voxels: Shaped[Array | ndarray, "*batch 32 32 16"], cloth: Cloth = PAPERS_CLOTH
) -> ProbabilisticMesh:
    """The net's estimate, a probabilistic mesh [normalised], from centred, occluded voxels (bool or 0 / 1): eq. (9)."""
    return estimator(net.config)(net.params, jnp.asarray(voxels), jnp.asarray(cloth))


def back(estimated: ProbabilisticMesh, k: int | Int[Array, "*batch"]) -> ProbabilisticMesh:
    """An estimate from voxels transformed by equivalent k, transformed back to the original orientation."""
    mean, std = estimated
    return ProbabilisticMesh(turned_back(mean, k), jnp.abs(turned_back(std, k)))


def turned(mesh: Mesh, k: int | Int[Array, "*batch"]) -> Float[Array, "*batch u v 3"]:
    """A mesh whose coordinates x and y are transformed as equivalent k transforms u and v."""
    return turn_mesh(jnp.asarray(mesh), axes(jnp.asarray(k)))


def turned_back(mesh: Mesh, k: int | Int[Array, "*batch"]) -> Float[Array, "*batch u v 3"]:
    """The inverse of `turned`."""
    return turn_mesh(jnp.asarray(mesh), jnp.swapaxes(axes(jnp.asarray(k)), -1, -2))


def relabelled_like(values: Mesh, like: Mesh, mesh: Mesh, cloth: Cloth = PAPERS_CLOTH) -> Float[Array, "*batch u v 3"]:
    """Values at a mesh's vertices, under the labels that bring `mesh` nearest to `like` and keep the cloth's sides."""
    nearest = best_label(like, mesh, cloth=cloth)
    return jnp.take_along_axis(equivalents(values), nearest[None, ..., None, None, None], axis=0)[0]
