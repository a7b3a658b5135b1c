"""Errors of estimates and predictions against the truth, for any of the cloth's labellings (section 6, design 2)."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from clothkit.cloth.mesh import Cloth, ProbabilisticMesh, best_label, distance, error
from clothkit.cloth.symmetry import relabel_batch
from clothkit.cloth.topology import SQUARE, Topology

errors = jax.jit(error, static_argnames=("aligned", "topology"))
labelled_errors = jax.jit(distance)


@partial(jax.jit, static_argnames="topology")
def labels_of_truth(
    mesh: Float[Array | np.ndarray, "batch u v 3"],
    truth: Float[Array | np.ndarray, "batch u v 3"],
    topology: Topology = SQUARE,
    cloth: Cloth | None = None,
) -> Int[Array, " batch"]:
    """Return, for each mesh, the equivalent k under which the relabelled mesh is nearest to its truth.

    With `cloth`, the cloths' sides and thicknesses, only equivalents with the same sides count.
    """
    return jnp.asarray(topology.inverses)[best_label(mesh, truth, topology=topology, cloth=cloth)]


relabelled = jax.jit(relabel_batch, static_argnames="topology")


@partial(jax.jit, static_argnames="topology")
def deviations(
    probabilistic: ProbabilisticMesh,
    truth: Float[Array | np.ndarray, "batch u v 3"],
    topology: Topology = SQUARE,
    cloth: Cloth | None = None,
) -> Float[Array, "batch u v 3"]:
    """Return abs(error) / sigma of every coordinate, after relabelling to the truth's labels (section 6.1)."""
    k = labels_of_truth(probabilistic.mean, truth, topology, cloth)
    mean, std = (relabel_batch(jnp.asarray(part), k, topology) for part in probabilistic)
    return jnp.abs(truth - mean) / std


@partial(jax.jit, static_argnames="topology")
def sigma_ratio(
    probabilistic: ProbabilisticMesh,
    truth: Float[Array | np.ndarray, "batch u v 3"],
    topology: Topology = SQUARE,
    cloth: Cloth | None = None,
) -> Float[Array, " batch"]:
    """Return the mean of each mesh's `deviations` (section 6.1)."""
    return jnp.mean(deviations(probabilistic, truth, topology, cloth), axis=(-3, -2, -1))
