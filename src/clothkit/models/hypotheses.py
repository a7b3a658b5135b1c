"""Hypotheses: the different shapes that voxels may show, each with its probability.

From above, a fold that lies on either side may look the same. The mean of the two shapes is a third one, which the
cloth does not have. So a net may answer with several probabilistic meshes. It is trained by their best one (multiple
choice learning: Guzman-Rivera et al., NeurIPS 2012), and learns how often each is the best.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from clothkit.cloth.mesh import Cloth, Mesh, ProbabilisticMesh, best_label, error
from clothkit.cloth.symmetry import equivalents
from clothkit.cloth.topology import PAPERS_CLOTH, thinned

DISTINCT = 0.05
"""Two meshes at least so far apart [cloth length] are different shapes."""

STRIDE = 4
"""Every so many vertices are compared, when shapes are told apart."""


class Hypotheses(NamedTuple):
    """Probabilistic meshes that voxels may show, and the probability of each; those of a batch have one number."""

    mesh: ProbabilisticMesh
    """[*batch hypothesis u v 3], the most probable first."""
    probability: Float[Array, "*batch hypothesis"]
    """Sums to one; zero where fewer shapes were found."""


def most_probable(found: Hypotheses) -> ProbabilisticMesh:
    """The first hypothesis."""
    return ProbabilisticMesh(*(part[..., 0, :, :, :] for part in found.mesh))


def ordered(found: Hypotheses) -> Hypotheses:
    """The same hypotheses, the most probable first."""
    order = jnp.argsort(-found.probability, axis=-1, stable=True)
    mesh = (jnp.take_along_axis(jnp.asarray(part), order[..., None, None, None], axis=-4) for part in found.mesh)
    return Hypotheses(ProbabilisticMesh(*mesh), jnp.take_along_axis(found.probability, order, axis=-1))


def merged(views: Sequence[Hypotheses], count: int, cloth: Cloth = PAPERS_CLOTH) -> Hypotheses:
    """The `count` most probable shapes among the hypotheses of several views of the same voxels.

    The mesh with the most probability within DISTINCT of it makes one shape with the meshes that are so near: their
    mixture's mean and standard deviation, in the labels nearest to it. Then the same is done with the rest.
    """
    mean, std = (jnp.concatenate(parts, axis=-4) for parts in zip(*(view.mesh for view in views), strict=True))
    probability = jnp.concatenate([view.probability for view in views], axis=-1) / len(views)
    few, cloths = thinned(mean, STRIDE), jnp.asarray(cloth)[..., None, :]
    away = error(few[..., :, None, :, :, :], few[..., None, :, :, :, :], cloth=cloths[..., None, :])
    shapes = []
    for _ in range(count):
        within = jnp.einsum("...ij,...j->...i", away < DISTINCT, probability)
        # A mesh that already belongs to a shape comes last.
        middle = jnp.argmax(jnp.where(probability > 0, within, -1.0), axis=-1)
        near = jnp.take_along_axis(away, middle[..., None, None], axis=-2)[..., 0, :] < DISTINCT
        share = probability * near
        # If no mesh is left, the shape is that of the mesh that happens to be taken, at no probability.
        weight = jnp.where(jnp.sum(share, -1, keepdims=True) > 0, share, jax.nn.one_hot(middle, share.shape[-1]))
        weight = (weight / jnp.sum(weight, axis=-1, keepdims=True))[..., None, None, None]
        like = jnp.take_along_axis(mean, middle[..., None, None, None, None], axis=-4)
        means, stds = relabelled_like(mean, like, mean, cloths), relabelled_like(std, like, mean, cloths)
        middle_mean = jnp.sum(weight * means, axis=-4)
        variance = jnp.sum(weight * (stds**2 + (means - middle_mean[..., None, :, :, :]) ** 2), axis=-4)
        shapes.append((middle_mean, jnp.sqrt(variance), jnp.sum(share, axis=-1)))
        probability = jnp.where(near, 0.0, probability)
    found_means, found_stds, found = zip(*shapes, strict=True)
    mesh = ProbabilisticMesh(jnp.stack(found_means, axis=-4), jnp.stack(found_stds, axis=-4))
    probabilities = jnp.stack(found, axis=-1)
    return Hypotheses(mesh, probabilities / jnp.sum(probabilities, axis=-1, keepdims=True))


def relabelled_like(values: Mesh, like: Mesh, mesh: Mesh, cloth: Cloth = PAPERS_CLOTH) -> Float[Array, "*batch u v 3"]:
    """Values at a mesh's vertices, under the labels that bring `mesh` nearest to `like` and keep the cloth's sides."""
    nearest = best_label(like, mesh, cloth=cloth)
    return jnp.take_along_axis(equivalents(values), nearest[None, ..., None, None, None], axis=0)[0]
