"""Uncertainty terms for meshes that know what was recorded: the expected error of the outcome, and plain surprise."""

from dataclasses import dataclass, field
from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from clothkit.models.forward import ForwardModel
from clothkit.models.support_model import SupportModel, inputs, surprise
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.measures import measure
from clothkit.planning.objective import Outlook
from clothkit.planning.types import Scalar

SIGNS = ("distance", "sigma", "surprise")
"""What tells how wrong a prediction may be: see `measures.Measures`, and the surprise of the manipulations so far."""

LEAST = (1e-3, 1e-3, 0.05)
"""Added to the signs: nets that agree exactly know no better."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Surprise:
    """A term: how surprising a plan's manipulations are, in the mean. It needs no second net."""

    weight: Scalar
    support: SupportModel
    model: ForwardModel = field(metadata={"static": True})
    net: int = field(default=0, metadata={"static": True})
    """Index of the net whose latents the support model was trained with."""
    every_step: ClassVar[bool] = False

    def of_each(self, outlook: Outlook) -> Float[Array, "n strains"]:
        """The surprise of each manipulation."""
        plan = jnp.swapaxes(outlook.plan, 0, 1)
        return surprise(self.support, inputs(self.model, outlook.latents[self.net], plan))

    def __call__(self, outlook: Outlook) -> Float[Array, " strains"]:
        return outlook.mean(self.of_each(outlook))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ModelError:
    """A term: the expected error of the prediction of a plan's outcome [cloth length]."""

    weight: Scalar
    error: ErrorMap
    surprise: Surprise
    every_step: ClassVar[bool] = False

    def __call__(self, outlook: Outlook) -> Float[Array, " strains"]:
        measures = measure(outlook.outcomes)
        count = outlook.plan.shape[1] if outlook.steps is None else outlook.steps
        surprises = count * self.surprise(outlook)
        return self.error((measures.distance, measures.sigma, surprises), count - 1)
