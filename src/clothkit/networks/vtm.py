"""VtM, the voxel-to-mesh net: seven fully connected neuron layers, probabilistic output (section 4.7, design 6.3)."""

import flax.linen as nn
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, PyTree, Shaped
from numpy import ndarray

from clothkit.cloth.equivalents import COUNT, SWAP, equivalents, relabel
from clothkit.cloth.mesh import Mesh, ProbabilisticMesh, distance
from clothkit.cloth.voxels import RESOLUTION, observe
from clothkit.manipulation.turns import turn_mesh
from clothkit.networks.canonical import axes, lies_along_y
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


def seen_by(net: Net, mesh: Float[Array | ndarray, "*batch u v 3"]) -> Bool[Array, "*batch 32 32 16"]:
    """What a camera above sees of meshes, up to the height that the net knows."""
    return observe(mesh, height=net.config.height)


def estimate(net: Net, voxels: Shaped[Array | ndarray, "*batch 32 32 16"]) -> ProbabilisticMesh:
    """The probabilistic mesh [normalised] that occluded, centred voxels (bool or 0 / 1) show: eq. (9).

    With eight views the net sees the voxels turned by right angles and mirrored, too. What it says of each is turned
    back, takes the labels under which it is nearest to the first, and becomes part of one mixture, of which mean and
    standard deviation are returned: the net knows no direction, and its errors do. To a canonical net two of the eight
    are the same each time.
    """
    voxels = jnp.asarray(voxels)
    count = COUNT if net.config.views > 1 else 1
    views = [seen_as(net, voxels, k) for k in range(0, count, 2 if net.config.canonical else 1)]
    if len(views) == 1:
        return views[0]
    first = views[0].mean
    labelled = [(relabelled_like(m, first, m), relabelled_like(s, first, m)) for m, s in views]
    means, stds = (jnp.stack(parts) for parts in zip(*labelled, strict=True))
    mean = jnp.mean(means, axis=0)
    return ProbabilisticMesh(mean, jnp.sqrt(jnp.mean(stds**2 + (means - mean) ** 2, axis=0)))


def seen_as(net: Net, voxels: Shaped[Array, "*batch x y z"], k: int) -> ProbabilisticMesh:
    """What the net says of voxels that it is shown under equivalent k of x and y; where they are as given."""
    shown = relabel(voxels, k)
    if not net.config.canonical:
        return back(run(VtM(net.config), net.params, shown), k)
    swap = lies_along_y(shown) * SWAP
    return back(back(run(VtM(net.config), net.params, relabel(shown, swap[..., None, None, None])), swap), k)


def back(estimated: ProbabilisticMesh, k: int | Int[Array, "*batch"]) -> ProbabilisticMesh:
    """An estimate from voxels under equivalent k of x and y, where the cloth lies."""
    mean, std = estimated
    return ProbabilisticMesh(turned_back(mean, k), jnp.abs(turned_back(std, k)))


def turned(mesh: Mesh, k: int | Int[Array, "*batch"]) -> Float[Array, "*batch u v 3"]:
    """A mesh as equivalent k, done to x and y instead of u and v, shows it."""
    return turn_mesh(jnp.asarray(mesh), axes(jnp.asarray(k)))


def turned_back(mesh: Mesh, k: int | Int[Array, "*batch"]) -> Float[Array, "*batch u v 3"]:
    """The opposite of `turned`."""
    return turn_mesh(jnp.asarray(mesh), jnp.swapaxes(axes(jnp.asarray(k)), -1, -2))


def relabelled_like(values: Mesh, like: Mesh, mesh: Mesh) -> Float[Array, "*batch u v 3"]:
    """Values over a mesh's vertices, under the labels that bring the mesh nearest to another."""
    nearest = jnp.argmin(distance(equivalents(mesh), like), axis=0)
    return jnp.take_along_axis(equivalents(values), nearest[None, ..., None, None, None], axis=0)[0]
