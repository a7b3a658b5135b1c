"""Building blocks of the nets: dense layers, their initial weights, and the probabilistic output of eq. (6)."""

from functools import partial
from math import prod
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from clothkit.cloth.mesh import Cloth, ProbabilisticMesh
from clothkit.cloth.topology import CLOTH_LENGTH, PAPERS_CLOTH, SQUARE
from clothkit.models.settings import Start

OUTPUTS = prod(SQUARE.shape) * 6
"""Units of a probabilistic output layer: mean and sigma's activation, for three coordinates of every vertex."""


def dense(width: int, name: str, *, scale: float = 1.0, bias: bool = True, start: float = 0.0) -> nn.Dense:
    """A dense layer whose initial weights are Glorot uniform times `scale`, and whose initial biases are `start`."""
    glorot = nn.initializers.variance_scaling(scale**2, "fan_avg", "uniform")
    return nn.Dense(width, use_bias=bias, kernel_init=glorot, bias_init=nn.initializers.constant(start), name=name)


def with_cloth(units: Float[Array, "*batch units"], cloth: Cloth) -> Float[Array, "*batch units_and_3"]:
    """A net's input with a cloth's sides and thickness [normalised] appended, scaled to about -1..1."""
    cloth = jnp.asarray(cloth)
    told = jnp.concatenate([2 * cloth[..., :2] / CLOTH_LENGTH - 1, jnp.log(cloth[..., 2:] / PAPERS_CLOTH[2])], axis=-1)
    return jnp.concatenate([units, jnp.broadcast_to(told, (*units.shape[:-1], 3))], axis=-1)


def probabilistic_output(name: str, start: Start) -> nn.Dense:
    """The output layer whose activations `probabilistic_mesh` converts."""
    is_sigma = jnp.arange(OUTPUTS) % 6 >= 3
    return nn.Dense(
        OUTPUTS,
        kernel_init=nn.initializers.variance_scaling(start.output**2, "fan_avg", "uniform"),
        bias_init=lambda key, shape, dtype: jnp.where(is_sigma, start.sigma, 0.0).astype(dtype),
        name=name,
    )


def probabilistic_mesh(activation: Float[Array, "*batch outputs"], least_std: float = 0.01) -> ProbabilisticMesh:
    """Eq. (6): the probabilistic mesh [normalised] for the activations of an output layer.

    Activations are ordered by u, v and then six channels: three means, and three values a with standard deviation
    exp(a) + `least_std`.
    """
    units = activation.reshape(*activation.shape[:-1], *SQUARE.shape, 6)
    return ProbabilisticMesh(units[..., :3], jnp.exp(units[..., 3:]) + least_std)


@partial(jax.jit, static_argnames=("module", "method"))
def run(module: nn.Module, params: PyTree, *inputs: Any, method: str | None = None) -> Any:
    """Apply a module, or one of its methods, with these weights to the inputs.

    Jitted, so that larger programs that use it many times with inputs of one shape trace it once.
    """
    return module.apply({"params": params}, *inputs, method=method)
