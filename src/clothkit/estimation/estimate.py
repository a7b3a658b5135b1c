"""Estimation of meshes from voxels: VtM, relabelling to match a prediction, refinement (4.7 and 5.1, design 6.10)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped

from clothkit.cloth.mesh import Cloth, ProbabilisticMesh, nll
from clothkit.cloth.symmetry import among_equal_labellings, relabel_batch
from clothkit.cloth.topology import PAPERS_CLOTH, SQUARE, Topology
from clothkit.estimation.layering import lift
from clothkit.estimation.refine import RefineConfig, refine
from clothkit.models import vtm
from clothkit.models.net import Net


class Estimate(NamedTuple):
    """An estimate: VtM's probabilistic mesh and the refined mesh, in the same labels [normalised]."""

    probabilistic: ProbabilisticMesh
    mesh: Float[Array, "batch u v 3"]


def estimate(
    net: Net,
    voxels: Shaped[Array | np.ndarray, "batch x y z"],
    settings: RefineConfig,
    *,
    predicted: Float[Array | np.ndarray, "batch u v 3"] | None = None,
    cloth: Cloth = PAPERS_CLOTH,
) -> Estimate:
    """Estimate meshes from centred voxels; `cloth` are the cloths' sides and thicknesses.

    Without `predicted`, refinement starts from VtM's means and the estimates have arbitrary labels. With predicted
    meshes, the estimates are relabelled to minimise the predictions' negative log likelihood, and refinement starts
    from the predictions.
    """
    probabilistic = estimate_probabilistic(net, voxels, predicted, cloth=cloth)
    start = probabilistic.mean if predicted is None else predicted
    refined = refine(probabilistic, start, settings, cloth=cloth, voxels=voxels, viewport=net.config.viewport)
    return Estimate(probabilistic, lifted(refined, cloth) if settings.lift else refined)


def lifted(meshes: Float[Array, "batch u v 3"], cloth: Cloth) -> Float[Array, "batch u v 3"]:
    """Meshes whose layers don't pierce one another (layering.py), of cloths with these sides and thicknesses."""
    measures = np.broadcast_to(np.asarray(cloth, float), (len(meshes), 3)).tolist()
    apart = [
        lift(mesh, thickness=thickness, sides=(along_u, along_v))
        for mesh, (along_u, along_v, thickness) in zip(np.asarray(meshes), measures, strict=True)
    ]
    return jnp.asarray(np.stack(apart))


def estimate_probabilistic(
    net: Net,
    voxels: Shaped[Array | np.ndarray, "batch x y z"],
    predicted: Float[Array | np.ndarray, "batch u v 3"] | None = None,
    *,
    cloth: Cloth = PAPERS_CLOTH,
) -> ProbabilisticMesh:
    """VtM's probabilistic meshes, in the same labels as the result of `estimate`."""
    probabilistic = _vtm(net, jnp.asarray(voxels), jnp.asarray(cloth))
    return probabilistic if predicted is None else labelled_like(probabilistic, predicted, cloth=cloth)


def estimate_unrefined(
    net: Net,
    voxels: Shaped[Array | np.ndarray, "batch x y z"],
    predicted: Float[Array | np.ndarray, "batch u v 3"] | None = None,
    *,
    cloth: Cloth = PAPERS_CLOTH,
) -> Float[Array, "batch u v 3"]:
    """VtM's means without refinement, in the same labels as the result of `estimate`."""
    return jnp.asarray(estimate_probabilistic(net, voxels, predicted, cloth=cloth).mean)


def labelled_like(
    probabilistic: ProbabilisticMesh,
    mesh: Float[Array | np.ndarray, "batch u v 3"],
    topology: Topology = SQUARE,
    *,
    cloth: Cloth | None = None,
) -> ProbabilisticMesh:
    """For each probabilistic mesh, the equivalent that minimises the negative log likelihood of the given mesh.

    With `cloth`, the cloths' sides and thicknesses, only equivalents with the same sides count.
    """
    batch = probabilistic.mean.shape[0]
    scores = []
    for k in range(topology.count):
        labels = np.full(batch, k)
        scores.append(nll(mesh, ProbabilisticMesh(*(relabel_batch(part, labels, topology) for part in probabilistic))))
    unlike = jnp.stack(scores)
    if cloth is not None:
        unlike = among_equal_labellings(unlike, cloth)
    best = jnp.argmin(unlike, axis=0)
    return ProbabilisticMesh(*(relabel_batch(part, best, topology) for part in probabilistic))


_vtm = jax.jit(vtm.estimate)
