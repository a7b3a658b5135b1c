"""Data-parallel training: every JAX device holds all weights and data, and computes an equal part of each batch."""

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import PyTree

from clothkit.runtime.errors import InputError


def _sharding(*axes: str) -> NamedSharding:
    return NamedSharding(Mesh(np.array(jax.devices()), ("batch",)), PartitionSpec(*axes))


def on_all(tree: PyTree) -> PyTree:
    """The arrays, replicated on every device."""
    return tree if jax.device_count() == 1 else jax.device_put(tree, _sharding())


def spread(examples: PyTree) -> PyTree:
    """The examples with their first axis, the batch, sharded over the devices; to be called inside jit.

    Random numbers do not depend on the sharding, so the batch is the same on any number of devices. Raises InputError
    if the batch size is not a multiple of the number of devices.
    """
    devices = jax.device_count()
    if devices == 1:
        return examples
    batch = jax.tree.leaves(examples)[0].shape[0]
    if batch % devices:
        raise InputError(f"training.batch is {batch}; {devices} devices need a multiple of {devices}")
    return jax.lax.with_sharding_constraint(examples, _sharding("batch"))
