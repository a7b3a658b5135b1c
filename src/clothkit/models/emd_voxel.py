"""The voxel EM*D, baseline A2: encoder and decoder for voxels with pEM*D's manipulator (section 6.2, design 6.15).

Grasp points are Cartesian, relative to the centre of the state that is manipulated, because voxels have no geodesic
coordinates.
"""

from dataclasses import dataclass
from math import prod

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, PyTree, Shaped
from numpy import ndarray

from clothkit.cloth.mesh import Cloth
from clothkit.cloth.topology import PAPERS_CLOTH
from clothkit.cloth.voxels import RESOLUTION
from clothkit.manipulation.geometry import to_cartesian
from clothkit.manipulation.vector import displacement, grasp_points
from clothkit.models.convolution import Convolution, TransposedConvolution, axes
from clothkit.models.layers import dense, run
from clothkit.models.pemd import Manipulator
from clothkit.models.settings import EMDVoxelConfig, Start

MAPS = (32, 32, 64, 128, 256)
"""Numbers of feature maps after E's first five layers at width 1; the sixth layer's output is the latent."""

STRIDES = ((2, 2, 1), *((2, 2, 2),) * 5)


def resolutions() -> list[tuple[int, int, int]]:
    """The resolution of E's input and of each layer's output: from 32 x 32 x 16 down to 1 x 1 x 1."""
    found = [RESOLUTION]
    for stride in STRIDES:
        x, y, z = (axis.out for axis in axes(found[-1], stride))
        found.append((x, y, z))
    return found


def maps(config: EMDVoxelConfig) -> list[int]:
    """The numbers of feature maps of E's input and of each layer's output."""
    return [1, *(max(1, round(count * config.width)) for count in MAPS), config.latent]


class VoxelEncoder(nn.Module):
    """E, eq. (2), for voxels: six convolutions with tanh between them and a linear output.

    With `dense`, fully connected layers instead.
    """

    config: EMDVoxelConfig

    @nn.compact
    def __call__(self, voxels: Shaped[Array, "*batch x y z"]) -> Float[Array, "*batch latent"]:
        units = voxels.astype(jnp.float32)
        if self.config.dense:
            units = units.reshape(*units.shape[:-3], -1)
            for i, width in enumerate(self.config.encoder):
                units = jnp.tanh(dense(width, f"layer_{i + 1}")(units))
            return dense(self.config.latent, "latent")(units)
        units = units[..., None]
        *hidden, last = zip(maps(self.config)[1:], STRIDES, strict=True)
        for i, (count, stride) in enumerate(hidden):
            units = jnp.tanh(Convolution(count, stride, name=f"layer_{i + 1}")(units))
        units = Convolution(*last, name="latent")(units)
        return units.reshape(*voxels.shape[:-3], -1)


class VoxelDecoder(nn.Module):
    """D, eq. (4), for voxels: E's layers transposed and in reverse order; the output is the logits of occupancy.

    With `dense`, fully connected layers instead.
    """

    config: EMDVoxelConfig
    start: Start

    @nn.compact
    def __call__(self, latent: Float[Array, "*batch latent"]) -> Float[Array, "*batch 32 32 16"]:
        if self.config.dense:
            units = latent
            for i, width in enumerate(self.config.decoder):
                units = jnp.tanh(dense(width, f"layer_{i + 1}")(units))
            last = dense(prod(RESOLUTION), "voxels", scale=self.start.output, start=self.start.logit)
            return last(units).reshape(*latent.shape[:-1], *RESOLUTION)
        units = latent[..., None, None, None, :]
        layers = list(zip(maps(self.config), STRIDES, resolutions(), strict=False))[::-1]
        for i, (count, stride, size) in enumerate(layers[:-1]):
            units = jnp.tanh(TransposedConvolution(count, stride, size, name=f"layer_{i + 1}")(units))
        start = self.start
        return TransposedConvolution(*layers[-1], scale=start.output, bias=start.logit, name="voxels")(units)[..., 0]


class EMDVoxelModule(nn.Module):
    """E, M and D in one module; `start` affects the initial weights only."""

    config: EMDVoxelConfig
    start: Start = Start()

    def setup(self) -> None:
        self.E = VoxelEncoder(self.config)
        self.M = Manipulator(self.config.latent, self.config.manipulation, self.start)
        self.D = VoxelDecoder(self.config, self.start)

    def __call__(
        self, voxels: Shaped[Array, "*batch x y z"], manipulation: Float[Array, "*batch 6"]
    ) -> Float[Array, "*batch x y z"]:
        latent = self.E(voxels)
        return self.D(self.M(latent, jnp.zeros_like(latent), manipulation)[0])

    def encode(self, voxels: Shaped[Array, "*batch x y z"]) -> Float[Array, "*batch latent"]:
        return self.E(voxels)

    def step(
        self,
        latent: Float[Array, "*batch latent"],
        trace: Float[Array, "*batch latent"],
        manipulation: Float[Array, "*batch 6"],
    ) -> tuple[Float[Array, "*batch latent"], Float[Array, "*batch latent"], Float[Array, "*batch 2"]]:
        return self.M(latent, trace, manipulation)

    def decode(self, latent: Float[Array, "*batch latent"]) -> Float[Array, "*batch x y z"]:
        return self.D(latent)


def initial(config: EMDVoxelConfig, start: Start = Start(), *, key: PRNGKeyArray) -> PyTree:  # noqa: B008
    """Initial weights for training."""
    return EMDVoxelModule(config, start).init(key, jnp.zeros(RESOLUTION), jnp.zeros(6))["params"]


@dataclass(frozen=True)
class EMDVoxel:
    """The voxel EM*D as a `ForwardModel`: states are voxels, predictions the logits of their occupancy."""

    config: EMDVoxelConfig

    def encode(
        self, params: PyTree, state: Shaped[Array | ndarray, "*batch 32 32 16"], cloth: Cloth = PAPERS_CLOTH
    ) -> Float[Array, "*batch latent"]:
        """The latent of occluded, centred voxels (bool or 0 / 1): eq. (2). The net is not told the cloth's sides."""
        del cloth
        return run(EMDVoxelModule(self.config), params, jnp.asarray(state), method="encode")

    def step(
        self,
        params: PyTree,
        latent: Float[Array | ndarray, "*batch latent"],
        trace: Float[Array | ndarray, "*batch latent"],
        manipulation: Float[Array | ndarray, "*batch 6"],
    ) -> tuple[Float[Array, "*batch latent"], Float[Array, "*batch latent"], Float[Array, "*batch 2"]]:
        """Latent, memory trace and centre shift [normalised] after a manipulation with Cartesian grasp points: eq. (3).

        The first memory trace is zero.
        """
        latent, trace, manipulation = map(jnp.asarray, (latent, trace, manipulation))
        return run(EMDVoxelModule(self.config), params, latent, trace, manipulation, method="step")

    def decode(
        self, params: PyTree, latent: Float[Array | ndarray, "*batch latent"], stride: int = 1
    ) -> Float[Array, "*batch 32 32 16"]:
        """The logits of occupancy for a latent: eq. (4) without the sigmoid. D always computes the whole volume."""
        return run(EMDVoxelModule(self.config), params, jnp.asarray(latent), method="decode")


def cartesian(
    states: Float[Array | ndarray, "*batch n u v 3"], manipulations: Float[Array | ndarray, "*batch n 6"]
) -> Float[Array, "*batch n 6"]:
    """Convert recorded manipulations to this net's input: m' of eq. (3), x1 y1 x2 y2 dx dy [normalised].

    `states` are the true meshes before each manipulation. They are centred, so that points on them are relative to
    their own centre, which is the shift by -a_i of eq. (3). Grasp points of all manipulations but the first are clipped
    to the viewport (design 6.15).
    """
    first, second = grasp_points(manipulations)
    grasps = jnp.concatenate([to_cartesian(states, uv)[..., :2] for uv in (first, second)], axis=-1)
    later = jnp.arange(grasps.shape[-2])[:, None] > 0
    grasps = jnp.where(later, jnp.clip(grasps, -1, 1), grasps)
    return jnp.concatenate([grasps, jnp.asarray(displacement(manipulations))], axis=-1)


def cross_entropy(
    logits: Float[Array, "*batch x y z"], truth: Shaped[Array, "*#batch x y z"]
) -> Float[Array, "*batch"]:
    """Binary cross-entropy between the truth (bool or 0 / 1) and logits of occupancy, averaged over voxels [nat]."""
    return jnp.mean(jax.nn.softplus(logits) - logits * truth, axis=(-3, -2, -1))
