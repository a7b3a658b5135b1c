"""Refinement: a physically plausible mesh that is likely under a probabilistic mesh (section 4.7, eqs. 10 and 11)."""

from functools import partial
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from annotated_types import Ge, Gt, Le
from jaxtyping import Array, Bool, Float, Int, Shaped

from clothkit.cloth.mesh import Cloth, ProbabilisticMesh, nll
from clothkit.cloth.topology import SQUARE, Shape, Topology
from clothkit.cloth.voxels import RESOLUTION, VIEWPORT, Viewport
from clothkit.estimation.explanation import Bounds, Columns, bounds_of, columns, unexplained
from clothkit.runtime.config import config

SHORTEST_SPRING = 1e-6
"""Lower bound of spring lengths [normalised], because the gradient of a length is not defined at zero."""


CREASE = 0.01
"""Second differences shorter than this [normalised] count as smooth."""


@config
class Level:
    """A grid of control points, by which the vertices between them also move, linearly in between."""

    points: Annotated[int, Ge(2)]
    """Control points along each side."""
    stride: Annotated[float, Gt(0)]
    """Step size of the control points, in those of the vertices."""


@config
class RefineConfig:
    """Weights of the loss, step size and stopping rule of refinement; PAPERS has the paper's."""

    spring_weight: Annotated[float, Ge(0)] = 5000.0
    slack_weight: Annotated[float, Ge(0), Le(1)] = 0.05
    """Weight of springs that are shorter than at rest, in that of longer ones; the paper's is 1. No cloth is stretched,
    but where a probabilistic mesh is unsure, its mean is shorter, and nearer to the truth than one of full length."""
    upward_weight: Annotated[float, Ge(0)] = 1000.0
    observed_weight: Annotated[float, Ge(0)] = 2e5
    """Weight of the term that has a mesh explain the observed voxels, which the paper has not: `explanation.py`."""
    bending_weight: Annotated[float, Ge(0)] = 30.0
    """Weight of `bending`, which the paper has not. Noise crumples a mesh, and crumpled meshes pierce themselves."""
    greatest_std: Annotated[float, Gt(0)] | None = 0.04
    """Standard deviations above this [normalised] count as this; null: none does. Where a probabilistic mesh is very
    unsure, its mean is no shape of a cloth, but nearer to the truth than most shapes that are: it is not given up."""
    prior: Annotated[float, Gt(0)] | None = 1.0
    """By how much standard deviations of predictions are taken to be larger than nets say, where an estimate is fused
    with the prediction of the same state (`estimate.fused`); null: it is not, as in the paper."""
    lift: bool = True
    """Whether layers that pierce one another are moved apart at the end (layering.py), which the paper has not."""
    doubt: Annotated[float, Ge(0)] = 20.0
    """How much a hypothesis that explains the voxels worse than another loses of its probability: e-fold for 1 /
    `doubt` less of the intersection over union of the occluded voxels."""
    calls: Annotated[int, Gt(0), Le(RESOLUTION[0] * RESOLUTION[1])] = 64
    """Largest number of columns of voxels that call a point at a time."""
    renewed: Annotated[int, Gt(0)] = 10
    """Iterations between two choices of the bounds by which a mesh explains the voxels."""
    step: Annotated[float, Gt(0)] = 0.001
    """Step size of SignSGD: the change of each coordinate per iteration [normalised]."""
    settle: bool = True
    """Whether the step size falls linearly to zero, which the paper's does not, so that vertices come to rest."""
    coarse: tuple[Level, ...] = (Level(points=8, stride=2.0), Level(points=16, stride=1.0))
    """Grids that move along with the vertices, which the paper has not. Where a probabilistic mesh is unsure, its mean
    is too small; vertices that are pushed apart one by one crumple it, coarse moves spread it out."""
    iterations: Annotated[int, Ge(0)] = 150
    """Largest number of iterations."""
    tolerance: Annotated[float, Ge(0)] = 1e-3
    """Relative decrease of a mesh's loss that counts as an improvement."""
    patience: Annotated[int, Gt(0)] = 20
    """Iterations without improvement after which a mesh's refinement stops; new bounds count as an improvement."""


PAPERS = RefineConfig(
    slack_weight=1.0,
    observed_weight=0.0,
    bending_weight=0.0,
    greatest_std=None,
    prior=None,
    lift=False,
    settle=False,
    coarse=(),
    iterations=300,
)
"""Refinement as in section 4.7."""


def spring_energy(
    mesh: Float[Array | np.ndarray, "*batch u v 3"],
    topology: Topology = SQUARE,
    cloth: Cloth | None = None,
    *,
    slack_weight: float = 1.0,
) -> Float[Array, "*batch"]:
    """Eq. (11): the sum over springs of (length - rest)² [normalised²], of those below rest times `slack_weight`.

    With `cloth`, the sides and thickness of each, rest lengths are those of a flat cloth with these sides. Raises
    ValueError if the mesh has other numbers of vertices than the topology.
    """
    mesh = jnp.asarray(mesh)
    rows, columns = topology.shape
    if mesh.shape[-3:-1] != topology.shape:
        raise ValueError(f"mesh of {mesh.shape[-3:-1]} vertices for a topology of {topology.shape}")
    energy = jnp.zeros(mesh.shape[:-3], mesh.dtype)
    # Slices instead of the index pairs of `Topology.springs`, because gathering costs more than the rest of the loss.
    for du, dv, of_topology in topology.spring_offsets:
        low, high = max(0, -dv), columns - max(0, dv)
        spring = mesh[..., du:, low + dv : high + dv, :] - mesh[..., : rows - du, low:high, :]
        length = jnp.sqrt(jnp.maximum(jnp.sum(spring**2, axis=-1), SHORTEST_SPRING**2))
        rest = of_topology if cloth is None else _rest(jnp.asarray(cloth), du, dv, topology.shape)[..., None, None]
        energy += jnp.sum(jnp.where(length < rest, slack_weight, 1) * (length - rest) ** 2, axis=(-2, -1))
    return energy


def _rest(cloth: Float[Array, "*batch 3"], du: int, dv: int, shape: Shape) -> Float[Array, "*batch"]:
    """Rest length of the springs with this grid offset in flat cloths with these sides."""
    along_u, along_v = (cloth[..., axis] * steps / (shape[axis] - 1) for axis, steps in enumerate((du, dv)))
    return jnp.sqrt(along_u**2 + along_v**2)


def upward_bias(mesh: Float[Array, "*batch u v 3"], estimate: ProbabilisticMesh) -> Float[Array, "*batch"]:
    """Loss_up: the mean over vertices of the distance by which the mesh is below the estimate's mean [normalised]."""
    return jnp.mean(jnp.maximum(0, estimate.mean[..., 2] - mesh[..., 2]), axis=(-2, -1))


def bending(mesh: Float[Array, "*batch u v 3"]) -> Float[Array, "*batch"]:
    """The sum of the lengths of the second differences along u and along v [normalised].

    Lengths, and not their squares, so that a crease costs as much as a wide bend by the same angle (total variation:
    Rudin, Osher and Fatemi 1992, here of the first differences). For length l it is sqrt(l² + CREASE²).
    """
    total = jnp.zeros(mesh.shape[:-3], mesh.dtype)
    for axis in (-3, -2):
        squared = jnp.sum(jnp.diff(mesh, n=2, axis=axis) ** 2, axis=-1)
        total += jnp.sum(jnp.sqrt(squared + CREASE**2), axis=(-2, -1))
    return total


def refinement_loss(
    mesh: Float[Array, "*batch u v 3"],
    estimate: ProbabilisticMesh,
    settings: RefineConfig,
    topology: Topology = SQUARE,
    cloth: Cloth | None = None,
) -> Float[Array, "*batch"]:
    """The compound loss of section 4.7 and bending: all are sums but the upward bias, a mean (design 6.16)."""
    coordinates = mesh.shape[-3] * mesh.shape[-2] * mesh.shape[-1]
    if settings.greatest_std is not None:
        estimate = estimate._replace(std=jnp.minimum(estimate.std, settings.greatest_std))
    loss = (
        coordinates * nll(mesh, estimate)
        + settings.spring_weight * spring_energy(mesh, topology, cloth, slack_weight=settings.slack_weight)
        + settings.upward_weight * upward_bias(mesh, estimate)
    )
    return loss + settings.bending_weight * bending(mesh) if settings.bending_weight else loss


class _Search(NamedTuple):
    iteration: Int[Array, ""]
    mesh: Float[Array, "batch u v 3"]
    found: Float[Array, "batch u v 3"]
    lowest: Float[Array, " batch"]
    level: Float[Array, " batch"]
    stale: Int[Array, " batch"]
    bounds: Bounds | None


@partial(jax.jit, static_argnames=("settings", "topology", "viewport"))
def refine(
    estimate: ProbabilisticMesh,
    start: Float[Array | np.ndarray, "batch u v 3"],
    settings: RefineConfig,
    topology: Topology = SQUARE,
    *,
    cloth: Cloth | None = None,
    voxels: Shaped[Array | np.ndarray, "batch x y z"] | None = None,
    viewport: Viewport = VIEWPORT,
) -> Float[Array, "batch u v 3"]:
    """R of eq. (10): for each mesh of the batch, the mesh of lowest loss that SignSGD finds from `start`.

    `cloth` are the cloths' sides and thicknesses, if they are not the topology's. With `observed_weight`, meshes are
    also to explain the occluded `voxels` of that viewport. A mesh stops when its own loss has stabilised, so that its
    result does not depend on the rest of the batch.
    """
    seen = columns(voxels, viewport=viewport) if voxels is not None and settings.observed_weight else None

    def total(mesh: Array, bounds: Bounds | None) -> tuple[Array, Array]:
        loss = refinement_loss(mesh, estimate, settings, topology, cloth)
        if bounds is not None:
            loss += settings.observed_weight * unexplained(mesh, bounds)
        return jnp.sum(loss), loss

    def renewed(search: _Search, seen: Columns) -> _Search:
        """The search with new bounds, so that losses before are not comparable."""
        return search._replace(
            bounds=bounds_of(search.mesh, seen, settings.calls),
            lowest=jnp.full_like(search.lowest, jnp.inf),
            level=jnp.full_like(search.level, jnp.inf),
        )

    def searching(search: _Search) -> Bool[Array, ""]:
        return (search.iteration < settings.iterations) & jnp.any(search.stale < settings.patience)

    def move(search: _Search) -> _Search:
        if seen is not None:
            due = search.iteration % settings.renewed == 0
            search = jax.lax.cond(due, lambda search: renewed(search, seen), lambda search: search, search)
        gradient, loss = jax.grad(total, has_aux=True)(search.mesh, search.bounds)
        step = settings.step * (1 - search.iteration / settings.iterations if settings.settle else 1)
        active = search.stale < settings.patience
        lower = active & (loss < search.lowest)
        # `level` is the loss at the last improvement, so that many small decreases add up to one.
        fell = jnp.isinf(search.level) | (loss < search.level - settings.tolerance * jnp.abs(search.level))
        return _Search(
            search.iteration + 1,
            search.mesh - step * active[:, None, None, None] * _direction(gradient, settings.coarse),
            jnp.where(lower[:, None, None, None], search.mesh, search.found),
            jnp.where(lower, loss, search.lowest),
            jnp.where(active & fell, loss, search.level),
            jnp.where(active, jnp.where(fell, 0, search.stale + 1), search.stale),
            search.bounds,
        )

    start = jnp.asarray(start)
    unknown = jnp.full(len(start), jnp.inf, start.dtype)
    unbound = None if seen is None else bounds_of(start, seen, settings.calls)
    first = _Search(jnp.int32(0), start, start, unknown, unknown, jnp.zeros(len(start), jnp.int32), unbound)
    return jax.lax.while_loop(searching, move, first).found


def _direction(gradient: Float[Array, "batch u v 3"], coarse: tuple[Level, ...]) -> Float[Array, "batch u v 3"]:
    """The direction of SignSGD for all vertices, and for all grids of control points, at the vertices."""
    direction = jnp.sign(gradient)
    for level in coarse:
        along_u, along_v = (_shares(level.points, vertices) for vertices in gradient.shape[1:3])
        of_points = jnp.einsum("ui,buvc,vj->bijc", along_u, gradient, along_v)
        direction += level.stride * jnp.einsum("ui,bijc,vj->buvc", along_u, jnp.sign(of_points), along_v)
    return direction


def _shares(points: int, vertices: int) -> Float[np.ndarray, "vertices points"]:
    """The share of each of a line's control points in the displacement of each vertex, by linear interpolation."""
    return np.array(
        [np.interp(np.linspace(0, points - 1, vertices), np.arange(points), one) for one in np.eye(points)], np.float32
    ).T
