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
from clothkit.estimation.explanation import Columns, Pulls, columns, pulls, unexplained
from clothkit.runtime.config import config

SHORTEST_SPRING = 1e-6
"""Lower bound of spring lengths [normalised], because the gradient of a length is not defined at zero."""


@config
class Level:
    """A stage of refinement in which a mesh moves as a coarse grid of control points does, linearly in between."""

    points: Annotated[int, Ge(2)]
    """Control points along each side."""
    step: Annotated[float, Gt(0)]
    """Step size of SignSGD for the control points [normalised]."""
    iterations: Annotated[int, Gt(0)]
    """Largest number of iterations."""


@config
class RefineConfig:
    """Weights of the loss, step size and stopping rule of refinement; the defaults are the paper's."""

    spring_weight: Annotated[float, Ge(0)] = 5000.0
    upward_weight: Annotated[float, Ge(0)] = 1000.0
    lift: bool = False
    """Whether layers that pierce one another are moved apart at the end (layering.py), which the paper has not."""
    coarse: tuple[Level, ...] = ()
    """Stages before that in which each vertex moves for itself, which the paper has not. Where a probabilistic mesh is
    unsure, its mean is too small; vertices that are pushed apart one by one crumple it, coarse moves spread it out."""
    observed_weight: Annotated[float, Ge(0)] = 0.0
    """Weight of the term that has a mesh explain the observed voxels, which the paper has not: `explanation.py`."""
    doubt: Annotated[float, Ge(0)] = 20.0
    """How much a hypothesis that explains the voxels worse than another loses of its probability: e-fold for 1 /
    `doubt` less of the intersection over union of the occluded voxels."""
    pulls: Annotated[int, Gt(0), Le(RESOLUTION[0] * RESOLUTION[1])] = 64
    """Largest number of columns of voxels that pull a vertex at a time."""
    renewed: Annotated[int, Gt(0)] = 10
    """Iterations between two choices of these columns."""
    step: Annotated[float, Gt(0)] = 0.001
    """Step size of SignSGD: the change of each coordinate per iteration [normalised]."""
    iterations: Annotated[int, Ge(0)] = 300
    """Largest number of iterations."""
    tolerance: Annotated[float, Ge(0)] = 1e-3
    """Relative decrease of a mesh's loss that counts as an improvement."""
    patience: Annotated[int, Gt(0)] = 20
    """Iterations without improvement after which a mesh's refinement stops."""


def spring_energy(
    mesh: Float[Array | np.ndarray, "*batch u v 3"], topology: Topology = SQUARE, cloth: Cloth | None = None
) -> Float[Array, "*batch"]:
    """Eq. (11): the sum over springs of (length - rest)² [normalised²].

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
        energy += jnp.sum((length - rest) ** 2, axis=(-2, -1))
    return energy


def _rest(cloth: Float[Array, "*batch 3"], du: int, dv: int, shape: Shape) -> Float[Array, "*batch"]:
    """Rest length of the springs with this grid offset in flat cloths with these sides."""
    along_u, along_v = (cloth[..., axis] * steps / (shape[axis] - 1) for axis, steps in enumerate((du, dv)))
    return jnp.sqrt(along_u**2 + along_v**2)


def upward_bias(mesh: Float[Array, "*batch u v 3"], estimate: ProbabilisticMesh) -> Float[Array, "*batch"]:
    """Loss_up: the mean over vertices of the distance by which the mesh is below the estimate's mean [normalised]."""
    return jnp.mean(jnp.maximum(0, estimate.mean[..., 2] - mesh[..., 2]), axis=(-2, -1))


def refinement_loss(
    mesh: Float[Array, "*batch u v 3"],
    estimate: ProbabilisticMesh,
    settings: RefineConfig,
    topology: Topology = SQUARE,
    cloth: Cloth | None = None,
) -> Float[Array, "*batch"]:
    """The compound loss of section 4.7: NLL and springs are sums, the upward bias is a mean (design 6.16)."""
    coordinates = mesh.shape[-3] * mesh.shape[-2] * mesh.shape[-1]
    return (
        coordinates * nll(mesh, estimate)
        + settings.spring_weight * spring_energy(mesh, topology, cloth)
        + settings.upward_weight * upward_bias(mesh, estimate)
    )


class _Search(NamedTuple):
    iteration: Int[Array, ""]
    mesh: Float[Array, "batch u v 3"]
    found: Float[Array, "batch u v 3"]
    lowest: Float[Array, " batch"]
    level: Float[Array, " batch"]
    stale: Int[Array, " batch"]
    pulled: Pulls | None


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
    also to explain the occluded `voxels` of that viewport. In each stage, a mesh stops when its own loss
    has stabilised, so that its result does not depend on the rest of the batch.
    """
    seen = columns(voxels, viewport=viewport) if voxels is not None and settings.observed_weight else None

    def total(mesh: Array, pulled: Pulls | None) -> tuple[Array, Array]:
        loss = refinement_loss(mesh, estimate, settings, topology, cloth)
        if seen is not None and pulled is not None:
            loss += settings.observed_weight * unexplained(mesh, seen, pulled)
        return jnp.sum(loss), loss

    def renewed(search: _Search, seen: Columns) -> Pulls:
        due = search.iteration % settings.renewed == 0
        return jax.lax.cond(due, lambda mesh: pulls(mesh, seen, settings.pulls), lambda _: search.pulled, search.mesh)

    def stage(start: Array, step: float, iterations: int, points: int | None) -> Array:
        """The mesh of lowest loss on the way from `start`."""

        def searching(search: _Search) -> Bool[Array, ""]:
            return (search.iteration < iterations) & jnp.any(search.stale < settings.patience)

        def move(search: _Search) -> _Search:
            pulled = None if seen is None else renewed(search, seen)
            gradient, loss = jax.grad(total, has_aux=True)(search.mesh, pulled)
            moved = search.mesh - step * (jnp.sign(gradient) if points is None else _coarse_sign(gradient, points))
            active = search.stale < settings.patience
            lower = active & (loss < search.lowest)
            # `level` is the loss at the last improvement, so that many small decreases add up to one.
            fell = jnp.isinf(search.level) | (loss < search.level - settings.tolerance * jnp.abs(search.level))
            return _Search(
                search.iteration + 1,
                jnp.where(active[:, None, None, None], moved, search.mesh),
                jnp.where(lower[:, None, None, None], search.mesh, search.found),
                jnp.where(lower, loss, search.lowest),
                jnp.where(active & fell, loss, search.level),
                jnp.where(active, jnp.where(fell, 0, search.stale + 1), search.stale),
                pulled,
            )

        unknown = jnp.full(len(start), jnp.inf, start.dtype)
        pulled = None if seen is None else pulls(start, seen, settings.pulls)
        first = _Search(jnp.int32(0), start, start, unknown, unknown, jnp.zeros(len(start), jnp.int32), pulled)
        return jax.lax.while_loop(searching, move, first).found

    mesh = jnp.asarray(start)
    for level in settings.coarse:
        mesh = stage(mesh, level.step, level.iterations, level.points)
    return stage(mesh, settings.step, settings.iterations, None)


def _coarse_sign(gradient: Float[Array, "batch u v 3"], points: int) -> Float[Array, "batch u v 3"]:
    """The direction of SignSGD for a grid of points x points control points, at the vertices."""
    along_u, along_v = (_shares(points, vertices) for vertices in gradient.shape[1:3])
    of_points = jnp.einsum("ui,buvc,vj->bijc", along_u, gradient, along_v)
    return jnp.einsum("ui,bijc,vj->buvc", along_u, jnp.sign(of_points), along_v)


def _shares(points: int, vertices: int) -> Float[np.ndarray, "vertices points"]:
    """The share of each of a line's control points in the displacement of each vertex, by linear interpolation."""
    return np.array(
        [np.interp(np.linspace(0, points - 1, vertices), np.arange(points), one) for one in np.eye(points)], np.float32
    ).T
