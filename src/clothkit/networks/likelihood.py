"""The likelihood that training maximises: as in eqs. (8) and (12), or with uncertain vertices held in it."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from clothkit.cloth.mesh import Mesh, ProbabilisticMesh, coordinate_nll, nll


def held_nll(mesh: Mesh, predicted: ProbabilisticMesh, hold: float) -> Float[Array, "..."]:
    """Negative log likelihood in which coordinates of large sigma count more, the mean over a mesh's coordinates.

    A normal's gradient for the mean is the error over sigma squared, so that what is uncertain is soon learnt no more.
    Here each coordinate is weighted by sigma^(2 hold), without a gradient, whose mean over the mesh is one: 0 is the
    plain likelihood, 1 gives the means the gradient of a mean squared error. Seitzer et al., "On the pitfalls of
    heteroscedastic uncertainty estimation with probabilistic neural networks", ICLR 2022.
    """
    if hold == 0:
        return nll(mesh, predicted)
    weights = jax.lax.stop_gradient(jnp.asarray(predicted.std) ** (2 * hold))
    weights = weights / jnp.mean(weights, axis=(-3, -2, -1), keepdims=True)
    return jnp.mean(weights * coordinate_nll(mesh, predicted), axis=(-3, -2, -1))
