"""VtM, the voxel-to-mesh net: seven fully connected neuron layers, probabilistic output (section 4.7, design 6.3)."""

import flax.linen as nn
import jax.numpy as jnp
from jaxtyping import Array, PRNGKeyArray, PyTree, Shaped
from numpy import ndarray

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.voxels import RESOLUTION
from clothkit.networks.layers import dense, probabilistic_mesh, probabilistic_output, run
from clothkit.networks.net import Net
from clothkit.networks.settings import Start, VtMConfig

HIDDEN_LAYERS = 5


class VtM(nn.Module):
    """Five tanh layers between voxels and eq. (6); `start` only decides the initial weights."""

    config: VtMConfig
    start: Start = Start()

    @nn.compact
    def __call__(self, voxels: Shaped[Array, "*batch x y z"]) -> ProbabilisticMesh:
        units = voxels.reshape(*voxels.shape[:-3], -1).astype(jnp.float32)
        for i in range(HIDDEN_LAYERS):
            units = jnp.tanh(dense(self.config.hidden, f"layer_{i + 1}")(units))
        return probabilistic_mesh(probabilistic_output("mesh", self.start)(units))


def initial(config: VtMConfig, start: Start = Start(), *, key: PRNGKeyArray) -> PyTree:  # noqa: B008
    """Weights to start training from."""
    return VtM(config, start).init(key, jnp.zeros(RESOLUTION))["params"]


def estimate(net: Net, voxels: Shaped[Array | ndarray, "*batch 32 32 16"]) -> ProbabilisticMesh:
    """The probabilistic mesh [normalised] that occluded, centred voxels (bool or 0 / 1) show: eq. (9)."""
    return run(VtM(net.config), net.params, jnp.asarray(voxels))
