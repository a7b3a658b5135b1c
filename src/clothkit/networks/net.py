"""A trained net as one small pytree that jitted functions take."""

from dataclasses import dataclass, field
from typing import Any

import jax


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Net:
    """A net's configuration and its weights: a pytree of the weights, in which the configuration is static."""

    config: Any = field(metadata={"static": True})
    """A PEMDConfig, an EMDVoxelConfig or a VtMConfig."""
    params: Any
    """The weights, nested by module and layer, float32."""
