"""An uncertainty term that is conditional on the state: doubt relative to that about plans on the state's support.

diff of eq. (15) is compared with that of plans that are drawn on the data's support from the very state that the search
starts from: z = (log diff - median) / spread, over those draws. Eq. (15) compares with one mean and one deviation over
all states, although the nets differ by far more about complex states than about simple ones. The penalty is
softplus(z - gamma), in the mean over manipulations: its slope is at most 1.
"""

from dataclasses import dataclass, field, replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from clothkit.planning.objective import Outlook, mean_difference
from clothkit.planning.types import Scalar

Values = Float[Array | np.ndarray, "..."]

LEAST_DIFFERENCE = 1e-6
LEAST_SPREAD = 0.1
"""Least spread of the logarithms: 10 %."""
NORMAL = 1.4826
"""Standard deviation of a normal distribution in units of its median absolute deviation."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Conditional:
    """The term. `median` and `spread` are those of one problem; None before it is posed."""

    weight: Scalar
    gamma: Scalar
    median: Float[Array, " n"] | None = None
    spread: Float[Array, " n"] | None = None
    draws: int = field(default=64, metadata={"static": True})
    """Number of plans on the support with which a problem is posed."""
    every_step: ClassVar[bool] = True

    def posed(self, drawn: Outlook) -> "Conditional":
        """The term for the problem whose plans on the support are `drawn`."""
        logarithms = _logarithm(self._difference(drawn))
        median = jnp.median(logarithms, axis=1)
        spread = NORMAL * jnp.median(jnp.abs(logarithms - median[:, None]), axis=1)
        return replace(self, median=median, spread=jnp.maximum(spread, LEAST_SPREAD))

    def deviations(self, outlook: Outlook) -> Float[Array, "n strains"]:
        """z of each manipulation of the plans."""
        assert self.median is not None, "the term is posed first"
        assert self.spread is not None, "with both"
        return deviations(self._difference(outlook), self.median[:, None], self.spread[:, None])

    def __call__(self, outlook: Outlook) -> Float[Array, " strains"]:
        return outlook.mean(jax.nn.softplus(self.deviations(outlook) - self.gamma))

    def _difference(self, outlook: Outlook) -> Float[Array, "n strains"]:
        apart = mean_difference(outlook.representation, outlook.predictions)
        assert apart is not None, "an ensemble of at least two nets"
        return apart


def deviations(difference: Values, median: Values, spread: Values) -> Float[Array, "..."]:
    """z: by how many spreads the logarithm of the nets' difference is above the median of plans on the support."""
    return (_logarithm(difference) - median) / spread


def _logarithm(difference: Values) -> Float[Array, "..."]:
    return jnp.log(difference + LEAST_DIFFERENCE)
