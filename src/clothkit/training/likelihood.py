"""The negative log likelihood for training: as in eqs. (8) and (12), or with more weight on uncertain coordinates."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from clothkit.cloth.mesh import Mesh, ProbabilisticMesh, coordinate_nll, nll


def held_nll(mesh: Mesh, predicted: ProbabilisticMesh, hold: float) -> Float[Array, "..."]:
    """Negative log likelihood, averaged over a mesh's coordinates with weights that grow with sigma.

    The gradient of the plain likelihood with respect to a mean is the error divided by sigma squared, so that
    coordinates with a large sigma hardly learn any more. Here each coordinate is weighted by sigma^(2 hold), without
    gradient and scaled to a mean of one over the mesh. With hold = 0 this is the plain likelihood; with hold = 1 the
    gradient for the means is, up to scale, that of a mean squared error. Seitzer et al., "On the pitfalls of
    heteroscedastic uncertainty estimation with probabilistic neural networks", ICLR 2022.
    """
    if hold == 0:
        return nll(mesh, predicted)
    weights = jax.lax.stop_gradient(jnp.asarray(predicted.std) ** (2 * hold))
    weights = weights / jnp.mean(weights, axis=(-3, -2, -1), keepdims=True)
    return jnp.mean(weights * coordinate_nll(mesh, predicted), axis=(-3, -2, -1))
