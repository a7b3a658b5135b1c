"""Estimation of meshes from voxels: VtM, relabelling to and fusion with a prediction, refinement (4.7, 5.1)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped

from clothkit.cloth.mesh import Cloth, ProbabilisticMesh, nll
from clothkit.cloth.symmetry import among_equal_labellings, relabel_batch
from clothkit.cloth.topology import PAPERS_CLOTH, SQUARE, Topology
from clothkit.estimation.agreement import agreement
from clothkit.estimation.layering import lift
from clothkit.estimation.refine import RefineConfig, refine
from clothkit.models import vtm
from clothkit.models.hypotheses import Hypotheses, most_probable, ordered
from clothkit.models.net import Net

LEAST_PROBABLE = 0.02
"""Hypotheses with a smaller probability are not held against a prediction."""


class Estimate(NamedTuple):
    """An estimate: VtM's probabilistic mesh and the refined mesh, in the same labels [normalised]."""

    probabilistic: ProbabilisticMesh
    mesh: Float[Array, "batch u v 3"]


class Alternatives(NamedTuple):
    """The shapes that voxels may show, the most probable first, each with its refined mesh [normalised]."""

    found: Hypotheses
    """[batch hypothesis ...]; probabilities also tell how well each refined mesh explains the voxels."""
    mesh: Float[Array, "batch hypothesis u v 3"]


def estimate(
    net: Net,
    voxels: Shaped[Array | np.ndarray, "batch x y z"],
    settings: RefineConfig,
    *,
    predicted: ProbabilisticMesh | None = None,
    cloth: Cloth = PAPERS_CLOTH,
) -> Estimate:
    """Estimate meshes from centred voxels; `cloth` are the cloths' sides and thicknesses.

    Without `predicted`, refinement starts from VtM's means and the estimates have arbitrary labels; of several
    hypotheses the most probable is taken. With predictions of the same states, centred, the estimates are the
    hypotheses and the labels with the smallest negative log likelihood of the predictions' means, which refinement
    starts from; with `settings.prior`, they are fused with the predictions before.
    """
    if predicted is None:
        found, mesh = alternatives(net, voxels, settings, cloth=cloth)
        return Estimate(most_probable(found), mesh[:, 0])
    probabilistic = with_prediction(net, voxels, settings, predicted, cloth=cloth)
    start = predicted.mean if settings.prior is None else probabilistic.mean
    return Estimate(probabilistic, _refined(net, probabilistic, start, voxels, settings, cloth))


def with_prediction(
    net: Net,
    voxels: Shaped[Array | np.ndarray, "batch x y z"],
    settings: RefineConfig,
    predicted: ProbabilisticMesh,
    *,
    cloth: Cloth = PAPERS_CLOTH,
) -> ProbabilisticMesh:
    """VtM's meshes that fit the predictions best, in the labels that do; with `settings.prior`, fused with these."""
    probabilistic = estimate_probabilistic(net, voxels, predicted.mean, cloth=cloth)
    if settings.prior is None:
        return probabilistic
    return fused(probabilistic, predicted._replace(std=settings.prior * jnp.asarray(predicted.std)))


def fused(one: ProbabilisticMesh, other: ProbabilisticMesh) -> ProbabilisticMesh:
    """What two independent observations of the same coordinates tell together: the product of their normal densities.

    Means are weighted by the inverse variances. An infinite standard deviation tells nothing.
    """
    weights = jnp.asarray(one.std) ** -2, jnp.asarray(other.std) ** -2
    both = weights[0] + weights[1]
    return ProbabilisticMesh((weights[0] * one.mean + weights[1] * other.mean) / both, both**-0.5)


def alternatives(
    net: Net,
    voxels: Shaped[Array | np.ndarray, "batch x y z"],
    settings: RefineConfig,
    *,
    cloth: Cloth = PAPERS_CLOTH,
) -> Alternatives:
    """All hypotheses of the net, each refined from its mean.

    A hypothesis loses probability by the factor exp(`settings.doubt` x its lack of agreement with the voxels).
    """
    found = _vtm(net, jnp.asarray(voxels), jnp.asarray(cloth))
    count = found.probability.shape[1]
    cloths = jnp.broadcast_to(jnp.asarray(cloth), (len(found.probability), 3))
    if count == 1:
        only = most_probable(found)
        return Alternatives(found, _refined(net, only, only.mean, voxels, settings, cloth)[:, None])
    flat = ProbabilisticMesh(*(part.reshape(-1, *part.shape[2:]) for part in found.mesh))
    seen = np.repeat(np.asarray(voxels), count, axis=0)
    mesh = _refined(net, flat, flat.mean, seen, settings, jnp.repeat(cloths, count, axis=0))
    agrees = agreement(np.asarray(mesh), seen > 0, viewport=net.config.viewport, forgiven=0)
    heights = agrees.heights.reshape(-1, count)
    weight = found.probability * jnp.exp(settings.doubt * (heights - heights.max(axis=1, keepdims=True)))
    weight /= jnp.sum(weight, axis=1, keepdims=True)
    order = jnp.argsort(-weight, axis=1, stable=True)
    mesh = jnp.take_along_axis(mesh.reshape(-1, count, *mesh.shape[1:]), order[..., None, None, None], axis=1)
    return Alternatives(ordered(found._replace(probability=weight)), mesh)


def _refined(
    net: Net,
    probabilistic: ProbabilisticMesh,
    start: Float[Array | np.ndarray, "batch u v 3"],
    voxels: Shaped[Array | np.ndarray, "batch x y z"],
    settings: RefineConfig,
    cloth: Cloth,
) -> Float[Array, "batch u v 3"]:
    refined = refine(probabilistic, start, settings, cloth=cloth, voxels=voxels, viewport=net.config.viewport)
    return lifted(refined, cloth) if settings.lift else refined


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
    """VtM's most probable meshes or, with predicted meshes, those that fit these best, in the labels that do."""
    found = _vtm(net, jnp.asarray(voxels), jnp.asarray(cloth))
    if predicted is None:
        return most_probable(found)
    each = [
        labelled_like(ProbabilisticMesh(*(part[:, i] for part in found.mesh)), predicted, cloth=cloth)
        for i in range(found.probability.shape[1])
    ]
    unlike = jnp.stack([nll(predicted, hypothesis) for hypothesis in each], axis=1)
    best = jnp.argmin(jnp.where(found.probability < LEAST_PROBABLE, jnp.inf, unlike), axis=1)
    parts = (jnp.stack(parts, axis=1) for parts in zip(*each, strict=True))
    return ProbabilisticMesh(*(part[jnp.arange(len(best)), best] for part in parts))


def estimate_unrefined(
    net: Net,
    voxels: Shaped[Array | np.ndarray, "batch x y z"],
    predicted: Float[Array | np.ndarray, "batch u v 3"] | None = None,
    *,
    cloth: Cloth = PAPERS_CLOTH,
) -> Float[Array, "batch u v 3"]:
    """VtM's means without refinement."""
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


_vtm = jax.jit(vtm.hypotheses)
