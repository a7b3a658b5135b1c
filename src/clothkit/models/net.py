"""A trained net as one pytree, which can be passed to jitted functions."""

from dataclasses import dataclass, field
from typing import Any

import jax


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Net:
    """A net's configuration and weights: a pytree whose leaves are the weights; the configuration is static."""

    config: Any = field(metadata={"static": True})
    """A PEMDConfig, an EMDVoxelConfig or a VtMConfig."""
    params: Any
    """The weights, nested by module and layer, float32."""
