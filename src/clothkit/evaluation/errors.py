"""Errors of estimates and predictions against the truth, for any of the 8 labellings (section 6, design 2)."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from clothkit.cloth.equivalents import INVERSE, relabel_batch
from clothkit.cloth.mesh import ProbabilisticMesh, best_label, distance, error

errors = jax.jit(error, static_argnames="aligned")
labelled_errors = jax.jit(distance)


@jax.jit
def labels_of_truth(
    mesh: Float[Array | np.ndarray, "batch u v 3"], truth: Float[Array | np.ndarray, "batch u v 3"]
) -> Int[Array, " batch"]:
    """Return, for each mesh, the equivalent k in 0..7 under which the relabelled mesh is nearest to its truth."""
    return jnp.asarray(INVERSE)[best_label(mesh, truth)]


relabelled = jax.jit(relabel_batch)


@jax.jit
def deviations(
    probabilistic: ProbabilisticMesh, truth: Float[Array | np.ndarray, "batch u v 3"]
) -> Float[Array, "batch u v 3"]:
    """Return abs(error) / sigma of every coordinate, after relabelling to the truth's labels (section 6.1)."""
    k = labels_of_truth(probabilistic.mean, truth)
    mean, std = (relabel_batch(jnp.asarray(part), k) for part in probabilistic)
    return jnp.abs(truth - mean) / std


@jax.jit
def sigma_ratio(
    probabilistic: ProbabilisticMesh, truth: Float[Array | np.ndarray, "batch u v 3"]
) -> Float[Array, " batch"]:
    """Return the mean of each mesh's `deviations` (section 6.1)."""
    return jnp.mean(deviations(probabilistic, truth), axis=(-3, -2, -1))
