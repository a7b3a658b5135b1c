"""VtM, the voxel-to-mesh net: seven fully connected layers, probabilistic output (section 4.7, design 6.3)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import flax.linen as nn
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, PyTree, Shaped
from numpy import ndarray

from clothkit.cloth.mesh import Cloth, Mesh, ProbabilisticMesh
from clothkit.cloth.symmetry import relabel
from clothkit.cloth.topology import PAPERS_CLOTH, SQUARE, SWAP
from clothkit.cloth.voxels import RESOLUTION, observe
from clothkit.manipulation.turns import turn_mesh
from clothkit.models.canonical import axes, lies_along_y
from clothkit.models.hypotheses import Hypotheses, merged, most_probable, ordered, relabelled_like
from clothkit.models.layers import dense, probabilistic_mesh, probabilistic_output, run, with_cloth
from clothkit.models.net import Net
from clothkit.models.settings import Start, VtMConfig

HIDDEN_LAYERS = 5

SUPPORT_LAYER, UNITS = 1, "units"
"""The hidden layer, counted from 0, whose units tell how strange an observation is, and their name."""


SURENESS = 8
"""How much more a view counts that is surer than others. Views that disagree show different shapes, whose mean is none
of them; the surest is most often right."""


class VtM(nn.Module):
    """Five hidden layers with tanh, and the output of eq. (6); `start` affects the initial weights only.

    With several hypotheses, each has a hidden layer of its own before the output, which they share.
    """

    config: VtMConfig
    start: Start = Start()

    @nn.compact
    def __call__(self, voxels: Shaped[Array, "*batch x y z"], cloth: Cloth = PAPERS_CLOTH) -> Hypotheses:
        units = voxels.reshape(*voxels.shape[:-3], -1).astype(jnp.float32)
        if self.config.told:
            units = with_cloth(units, cloth)
        for i in range(HIDDEN_LAYERS):
            units = jnp.tanh(dense(self.config.hidden, f"layer_{i + 1}")(units))
            if i == SUPPORT_LAYER:
                self.sow("intermediates", UNITS, units)
        count, hidden = self.config.hypotheses, self.config.hidden
        logits = dense(count, "probability")(units) if count > 1 else jnp.zeros((*units.shape[:-1], 1))
        each = [jnp.tanh(dense(hidden, f"hypothesis_{i + 1}")(units)) for i in range(count)] if count > 1 else [units]
        output = probabilistic_output("mesh", self.start)(jnp.stack(each, axis=-2))
        return Hypotheses(probabilistic_mesh(output, self.config.least_std), nn.softmax(logits))


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
    ) -> Hypotheses:
        """The probabilistic meshes [normalised] of centred, occluded voxels (bool or 0 / 1): eq. (9).

        `cloth` are the cloth's sides and thickness, for nets that are told them.
        """
        ...


@dataclass(frozen=True)
class SinglePass:
    """An estimate is the net's output."""

    config: VtMConfig

    def __call__(
        self, params: PyTree, voxels: Shaped[Array, "*batch 32 32 16"], cloth: Cloth = PAPERS_CLOTH
    ) -> Hypotheses:
        return run(VtM(self.config), params, voxels, jnp.asarray(cloth))


@dataclass(frozen=True)
class Canonicalised:
    """An `Estimator` that shows another one only voxels that are widest along x."""

    estimator: Estimator

    def __call__(
        self, params: PyTree, voxels: Shaped[Array, "*batch 32 32 16"], cloth: Cloth = PAPERS_CLOTH
    ) -> Hypotheses:
        swap = lies_along_y(voxels) * SWAP
        return back(self.estimator(params, relabel(voxels, swap[..., None, None, None]), cloth), swap)


@dataclass(frozen=True)
class Views:
    """An `Estimator` that combines another one's estimates of the voxels, rotated by right angles and mirrored.

    Each estimate is transformed back. This averages out errors that depend on the orientation.
    """

    estimator: Estimator
    equivalents: tuple[int, ...]
    """The transformations of the axes x and y, as those of u and v by equivalent k."""

    def __call__(
        self, params: PyTree, voxels: Shaped[Array, "*batch 32 32 16"], cloth: Cloth = PAPERS_CLOTH
    ) -> Hypotheses:
        views = [back(self.estimator(params, relabel(voxels, k), cloth), k) for k in self.equivalents]
        count = views[0].probability.shape[-1]
        return merged(views, count, cloth) if count > 1 else averaged(views, cloth)


def averaged(views: Sequence[Hypotheses], cloth: Cloth = PAPERS_CLOTH) -> Hypotheses:
    """The mean and the standard deviation of the mixture of all views' meshes, in the labels nearest to the first.

    The weight of a view is the geometric mean of its standard deviations, to the power of -SURENESS.
    """
    first, cloth = views[0].mesh.mean, jnp.asarray(cloth)[..., None, :]
    labelled = [
        (relabelled_like(mean, first, mean, cloth), relabelled_like(std, first, mean, cloth))
        for (mean, std), _ in views
    ]
    means, stds = (jnp.stack(parts) for parts in zip(*labelled, strict=True))
    unsureness = jnp.mean(jnp.log(stds), axis=(-3, -2, -1), keepdims=True)
    weights = nn.softmax(-SURENESS * unsureness, axis=0)
    mean = jnp.sum(weights * means, axis=0)
    variance = jnp.sum(weights * (stds**2 + (means - mean) ** 2), axis=0)
    return Hypotheses(ProbabilisticMesh(mean, jnp.sqrt(variance)), views[0].probability)


def estimator(config: VtMConfig) -> Estimator:
    """The estimator that a net with this configuration was trained for."""
    single = SinglePass(config)
    shown = Canonicalised(single) if config.canonical else single
    if config.views == 1:
        return shown
    # A canonical net's estimates do not change when x and y are swapped: four of the eight views differ.
    views = (k for k in range(SQUARE.count) if not (config.canonical and k & SWAP))
    return Views(shown, tuple(views))


def hypotheses(net: Net, voxels: Shaped[Array | ndarray, "*batch 32 32 16"], cloth: Cloth = PAPERS_CLOTH) -> Hypotheses:
    """The net's estimates [normalised] from centred, occluded voxels (bool or 0 / 1), the most probable first."""
    found = estimator(net.config)(net.params, jnp.asarray(voxels), jnp.asarray(cloth))
    return ordered(found._replace(mesh=recalibrated(found.mesh, net.config)))


def recalibrated(mesh: ProbabilisticMesh, config: VtMConfig) -> ProbabilisticMesh:
    """Probabilistic meshes whose standard deviations are mapped as the configuration says."""
    if (config.sigma_factor, config.sigma_power) == (1, 1):
        return mesh
    return mesh._replace(std=config.sigma_factor * jnp.asarray(mesh.std) ** config.sigma_power)


def estimate(
    net: Net, voxels: Shaped[Array | ndarray, "*batch 32 32 16"], cloth: Cloth = PAPERS_CLOTH
) -> ProbabilisticMesh:
    """The net's most probable estimate, a probabilistic mesh [normalised]: eq. (9)."""
    return most_probable(hypotheses(net, voxels, cloth))


def hidden_units(
    net: Net, voxels: Shaped[Array | ndarray, "*batch 32 32 16"], cloth: Cloth = PAPERS_CLOTH
) -> Float[Array, "*batch units"]:
    """The units of layer SUPPORT_LAYER for voxels; those of a canonical net for the voxels as it takes them."""
    voxels = jnp.asarray(voxels)
    if net.config.canonical:
        voxels = relabel(voxels, (lies_along_y(voxels) * SWAP)[..., None, None, None])
    _, kept = VtM(net.config).apply({"params": net.params}, voxels, jnp.asarray(cloth), mutable=["intermediates"])
    return kept["intermediates"][UNITS][0]


def back(found: Hypotheses, k: int | Int[Array, "*batch"]) -> Hypotheses:
    """Estimates from voxels transformed by equivalent k, transformed back to the original orientation."""
    mean, std = (turned_back(part, k if isinstance(k, int) else k[..., None]) for part in found.mesh)
    return Hypotheses(ProbabilisticMesh(mean, jnp.abs(std)), found.probability)


def turned(mesh: Mesh, k: int | Int[Array, "*batch"]) -> Float[Array, "*batch u v 3"]:
    """A mesh whose coordinates x and y are transformed as equivalent k transforms u and v."""
    return turn_mesh(jnp.asarray(mesh), axes(jnp.asarray(k)))


def turned_back(mesh: Mesh, k: int | Int[Array, "*batch"]) -> Float[Array, "*batch u v 3"]:
    """The inverse of `turned`."""
    return turn_mesh(jnp.asarray(mesh), jnp.swapaxes(axes(jnp.asarray(k)), -1, -2))
