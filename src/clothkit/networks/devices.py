"""Training on all devices that JAX sees: each holds the weights and the data, and takes its share of a batch."""

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import PyTree

from clothkit.errors import InputError


def _sharding(*axes: str) -> NamedSharding:
    return NamedSharding(Mesh(np.array(jax.devices()), ("batch",)), PartitionSpec(*axes))


def on_all(tree: PyTree) -> PyTree:
    """Arrays copied to every device, whole."""
    return tree if jax.device_count() == 1 else jax.device_put(tree, _sharding())


def spread(examples: PyTree) -> PyTree:
    """Examples with their first axis, the batch, cut into a piece per device; inside jit.

    Random numbers do not depend on how they are cut, so the batch is the same on any number of devices. Raises
    InputError when the batch can't be cut evenly.
    """
    devices = jax.device_count()
    if devices == 1:
        return examples
    batch = jax.tree.leaves(examples)[0].shape[0]
    if batch % devices:
        raise InputError(f"training.batch is {batch}; {devices} devices need a multiple of {devices}")
    return jax.lax.with_sharding_constraint(examples, _sharding("batch"))
