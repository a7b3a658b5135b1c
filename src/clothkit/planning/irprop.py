"""iRprop-: a step size grows while its gradient keeps its sign, and shrinks when it flips (Igel and Hüsken, 2000)."""

from typing import Annotated

import jax.numpy as jnp
from annotated_types import Gt, Lt
from jaxtyping import Array, Float

from clothkit.runtime.config import config

Steps = Float[Array, "*batch"]


@config
class IRpropConfig:
    """Hyperparameters of iRprop-; the defaults are the paper's (section 5.1)."""

    grow: Annotated[float, Gt(1)] = 1.2
    """eta+: factor on the step size where the gradient keeps its sign."""
    shrink: Annotated[float, Gt(0), Lt(1)] = 0.5
    """eta-: factor on the step size where the gradient changes its sign."""
    least: Annotated[float, Gt(0)] = 1e-3
    """Delta_min: lower bound of the step size."""
    most: Annotated[float, Gt(0)] = 0.05
    """Delta_max: upper bound of the step size."""
    initial: Annotated[float, Gt(0)] = 0.05

    def __post_init__(self) -> None:
        if not self.least <= self.initial <= self.most:
            raise ValueError(f"initial must be at least {self.least:g} (least) and at most {self.most:g} (most)")


def irprop_minus(
    gradient: Steps, gradient_before: Steps, rate: Steps, settings: IRpropConfig
) -> tuple[Steps, Steps, Steps]:
    """One iRprop- step: the update to add to the variables, the gradient to store, and the new step sizes.

    All are elementwise. Where the gradient has changed sign, the update and the stored gradient are zero. `optax.rprop`
    is not used because it returns the update of the previous step (optax 0.2.8).
    """
    # Signs are multiplied, because the product of two small gradients would underflow to zero.
    agreement = jnp.sign(gradient) * jnp.sign(gradient_before)
    grown = jnp.minimum(rate * settings.grow, settings.most)
    shrunk = jnp.maximum(rate * settings.shrink, settings.least)
    rate = jnp.where(agreement > 0, grown, jnp.where(agreement < 0, shrunk, rate))
    gradient = jnp.where(agreement < 0, 0, gradient)
    return -jnp.sign(gradient) * rate, gradient, rate
