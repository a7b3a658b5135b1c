"""VtM, the voxel-to-mesh net: seven fully connected neuron layers, probabilistic output (section 4.7, design 6.3)."""

import flax.linen as nn
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, PyTree, Shaped
from numpy import ndarray

from clothkit.cloth.equivalents import REVERSE_U, REVERSE_V, SWAP, equivalents
from clothkit.cloth.mesh import Mesh, ProbabilisticMesh, distance
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
        return probabilistic_mesh(probabilistic_output("mesh", self.start)(units), self.config.least_std)


def initial(config: VtMConfig, start: Start = Start(), *, key: PRNGKeyArray) -> PyTree:  # noqa: B008
    """Weights to start training from."""
    return VtM(config, start).init(key, jnp.zeros(RESOLUTION))["params"]


def estimate(net: Net, voxels: Shaped[Array | ndarray, "*batch 32 32 16"]) -> ProbabilisticMesh:
    """The probabilistic mesh [normalised] that occluded, centred voxels (bool or 0 / 1) show: eq. (9).

    With eight views the net sees the voxels turned by right angles and mirrored, too. What it says of each is turned
    back, takes the labels under which it is nearest to the first, and becomes part of one mixture, of which mean and
    standard deviation are returned: the net knows no direction, and its errors do.
    """
    voxels = jnp.asarray(voxels)
    module = VtM(net.config)
    if net.config.views == 1:
        return run(module, net.params, voxels)
    views = [run(module, net.params, view) for view in equivalents(voxels)]
    turned = [ProbabilisticMesh(turned_back(m, k), jnp.abs(turned_back(s, k))) for k, (m, s) in enumerate(views)]
    first = turned[0].mean
    labelled = [(relabelled_like(m, first, m), relabelled_like(s, first, m)) for m, s in turned]
    means, stds = (jnp.stack(parts) for parts in zip(*labelled, strict=True))
    mean = jnp.mean(means, axis=0)
    return ProbabilisticMesh(mean, jnp.sqrt(jnp.mean(stds**2 + (means - mean) ** 2, axis=0)))


def turned_back(mesh: Mesh, k: int) -> Float[Array, "*batch u v 3"]:
    """A mesh seen in the k-th view, where equivalent k relabels x and y instead of u and v, as it lies."""
    x, y, z = jnp.moveaxis(mesh, -1, 0)
    x = -x if k & REVERSE_U else x
    y = -y if k & REVERSE_V else y
    return jnp.stack([y, x, z] if k & SWAP else [x, y, z], axis=-1)


def relabelled_like(values: Mesh, like: Mesh, mesh: Mesh) -> Float[Array, "*batch u v 3"]:
    """Values over a mesh's vertices, under the labels that bring the mesh nearest to another."""
    nearest = jnp.argmin(distance(equivalents(mesh), like), axis=0)
    return jnp.take_along_axis(equivalents(values), nearest[None, ..., None, None, None], axis=0)[0]
