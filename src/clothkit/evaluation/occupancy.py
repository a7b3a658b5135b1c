"""Predicted meshes as voxels: the probability that each voxel holds a vertex, eq. (16) (section 6.2).

As in `voxels.voxelise` (design 6.14), points outside the viewport are dropped in x and y and clamped in z: the lowest
voxels extend to minus infinity, the highest to infinity.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, Shaped

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.voxels import HEIGHT, RESOLUTION, VIEWPORT, Viewport, observe

DRAWS = 16
"""Meshes drawn from a prediction in `occluded_occupancy`; few suffice: differences to binary voxels are linear."""

TALL = Viewport(height=2 * HEIGHT)
"""Upper end of a second viewport [normalised]: 0.25. With section 4.7's viewport and resolution, voxels are eight times
finer in z than in x and y, though its text says four times (design 6.14); with this height they are four times finer.
"""

TALL_MEASURE = "voxel_error_025"
"""Column of tidy rows: the mean voxel difference in the viewport that is `TALL`.

With the suffix `_no_action` it is the difference between start and goal."""

_TOGETHER = 8
"""Vertices combined in one pass over the voxels, since the number of passes limits the speed."""


def _shares(edges: Float[np.ndarray, " edges"], mean: Array, std: Array) -> Float[Array, "... bins"]:
    """Return the probability of each bin between successive edges, under normal distributions."""
    below = jax.scipy.stats.norm.cdf(jnp.asarray(edges, jnp.float32), mean[..., None], std[..., None])
    return jnp.diff(below, axis=-1)


def _edges(viewport: Viewport) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    nx, ny, nz = RESOLUTION
    z = viewport.height * np.linspace(0, 1, nz + 1) ** viewport.curve
    z[[0, -1]] = -np.inf, np.inf
    return np.linspace(-1, 1, nx + 1), np.linspace(-1, 1, ny + 1), z


@partial(jax.jit, static_argnames="viewport")
def occupancy(mesh: ProbabilisticMesh, *, viewport: Viewport = VIEWPORT) -> Float[Array, "batch 32 32 16"]:
    """Return the probability, 0..1, that at least one vertex falls into each voxel, eq. (16).

    The result is exact: a vertex's probability of falling into a voxel is the integral of its normal distribution over
    the voxel, a product of differences of one-dimensional distribution functions.
    """
    mean, std = (jnp.asarray(part).reshape(len(part), -1, _TOGETHER, 3) for part in mesh)

    def combine(occupied: Array, vertices: tuple[Array, Array]) -> tuple[Array, None]:
        mean, std = vertices
        x, y, z = (_shares(edges, mean[..., i], std[..., i]) for i, edges in enumerate(_edges(viewport)))
        columns = x[..., :, None] * y[..., None, :]
        # Eq. (16)'s product in the form p + q (1 - p): as accurate near 0 and 1 as a sum of logarithms, but cheaper.
        for i in range(_TOGETHER):
            occupied = occupied + columns[:, i, :, :, None] * z[:, i, None, None, :] * (1 - occupied)
        return occupied, None

    start = jnp.zeros((len(mean), *RESOLUTION))
    return jax.lax.scan(combine, start, (jnp.moveaxis(mean, 1, 0), jnp.moveaxis(std, 1, 0)))[0]


@partial(jax.jit, static_argnames=("draws", "viewport"))
def occluded_occupancy(
    mesh: ProbabilisticMesh, *, draws: int = DRAWS, viewport: Viewport = VIEWPORT, key: PRNGKeyArray
) -> Float[Array, "batch 32 32 16"]:
    """Return the probability, 0..1, that a camera above sees each voxel occupied (doubled and occluded).

    It is the fraction over meshes drawn from the prediction, each vertex independently, as in eq. (16).
    """
    mean, std = (jnp.asarray(part) for part in mesh)

    def draw(key: PRNGKeyArray) -> Array:
        return observe(mean + std * jax.random.normal(key, mean.shape), viewport=viewport).astype(jnp.float32)

    return jnp.mean(jax.lax.map(draw, jax.random.split(key, draws)), axis=0)


def pooled(predicted: Float[Array, "*batch x y z"]) -> Float[Array, "*batch x y z"]:
    """Convert voxels predicted for the usual viewport to the viewport that is `TALL`.

    A new voxel gets the larger value of the two voxels inside it. In occluded voxels, where columns are filled from
    below, the lower one is occupied whenever the upper one is, so the probability that any of the two is occupied is
    the larger of both. Voxels above the usual viewport were not predicted and are empty.
    """
    pairs = predicted.reshape(*predicted.shape[:-1], -1, 2).max(axis=-1)
    return jnp.concatenate([pairs, jnp.zeros_like(pairs)], axis=-1)


@jax.jit
def differences(
    voxels: Shaped[Array | np.ndarray, "batch x y z"], truth: Shaped[Array | np.ndarray, "batch x y z"]
) -> Float[Array, " batch"]:
    """Return the mean absolute difference of voxel values, 0..1, as in tables 4 and 7."""
    return jnp.mean(jnp.abs(jnp.asarray(voxels, jnp.float32) - jnp.asarray(truth, jnp.float32)), axis=(-3, -2, -1))
