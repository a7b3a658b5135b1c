"""The expected error of a prediction, learned from probes: a monotone map from what an ensemble's nets say.

log e = offset_step + slope . log(measures), with slopes that are not negative: the error grows as a power of the nets'
distance, of their sigma, and of the plan's surprise. It is fitted by least squares in logarithms, and its mean is made
that of the probes by one factor (Duan, "Smearing estimate", 1983), since a mean in logarithms is a median of errors.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.optimize import lsq_linear

from clothkit.models.forward import ForwardModel
from clothkit.models.support_model import SupportModel, inputs, surprise
from clothkit.planning.measures import measure
from clothkit.planning.objective import Outlook
from clothkit.planning.types import Scalar
from clothkit.runtime.errors import InputError
from clothkit.runtime.json_file import read_json

LEAST = 1e-3
"""Added to lengths before their logarithm is taken [cloth length]: nets that agree exactly know no better."""

LEAST_SURPRISE = 0.05
"""Added to the surprise likewise."""


class Signs(NamedTuple):
    """What tells how wrong a prediction may be; the batch axes are those of the predictions."""

    distance: Float[Array, "*batch"] | Float[np.ndarray, "*batch"]
    sigma: Float[Array, "*batch"] | Float[np.ndarray, "*batch"]
    surprise: Float[Array, "*batch"] | Float[np.ndarray, "*batch"]
    """The sum over the manipulations so far."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ExpectedError:
    """A fitted map. Arrays are indexed by the number of manipulations, less one."""

    offset: Float[np.ndarray, " steps"]
    slope: Float[np.ndarray, "3"]
    """Powers of the signs, in their order."""
    ratios: Float[np.ndarray, " quantiles"]
    """Quantiles 0, 1 / n .. 1 of the probes' true error, relative to the expected one."""

    def __call__(self, signs: Signs, step: int | Int[Array | np.ndarray, "..."]) -> Float[Array, "*batch"]:
        """Return the expected error of predictions after step + 1 manipulations [cloth length]."""
        powers = sum(slope * values for slope, values in zip(self.slope, logarithms(signs), strict=True))
        return jnp.exp(jnp.asarray(self.offset)[step] + powers)

    def interval(self, expected: Float[np.ndarray, "*batch"], share: float = 0.8) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds between which a share of the probes' errors lay, for errors that are expected."""
        at = np.linspace(0, 1, len(self.ratios))
        low, high = np.interp([(1 - share) / 2, (1 + share) / 2], at, self.ratios)
        return expected * low, expected * high


def logarithms(signs: Signs) -> Signs:
    """Return the logarithms of the signs, which are finite."""
    least = (LEAST, LEAST, LEAST_SURPRISE)
    return Signs(*(jnp.log(values + small) for values, small in zip(signs, least, strict=True)))


def fit(
    signs: Signs, step: Int[np.ndarray, " probes"], error: Float[np.ndarray, " probes"], quantiles: int = 20
) -> ExpectedError:
    """Fit the map to probes: the signs of their predictions, manipulations so far less one, true errors.

    Raises ValueError for a step between the first and the last without probes.
    """
    steps = int(step.max()) + 1
    if missing := set(range(steps)) - set(step.tolist()):
        raise ValueError(f"expected probes of every step, found none of step {min(missing)}")
    shown = np.stack([np.asarray(values) for values in logarithms(signs)], axis=-1)
    columns = np.concatenate([np.eye(steps)[step], shown], axis=-1)
    wanted = np.log(np.maximum(error, LEAST))
    bounds = (np.concatenate([np.full(steps, -np.inf), np.zeros(shown.shape[1])]), np.inf)
    found = lsq_linear(columns, wanted, bounds, method="bvls").x
    ratio = np.maximum(error, LEAST) / np.exp(columns @ found)
    mean = ratio.mean()
    offset, slope = found[:steps] + np.log(mean), found[steps:]
    return ExpectedError(offset, slope, np.quantile(ratio / mean, np.linspace(0, 1, quantiles + 1)))


def save(path: Path, error: ExpectedError, attributes: dict[str, Any]) -> None:
    """Write a map and the attributes (the params that it was made with) as JSON."""
    numbers = {name: np.asarray(values).tolist() for name, values in vars(error).items()}
    path.write_text(json.dumps({**numbers, "attributes": attributes}, indent=1) + "\n")


def load(path: Path) -> ExpectedError:
    """Read a map. Raises InputError for a file that is missing, damaged, or lacks a field."""
    stored = read_json(path, expected="JSON with offset, slope and ratios; run the stage that writes it (dvc repro)")
    try:
        found = ExpectedError(*(np.array(stored[name], float) for name in ("offset", "slope", "ratios")))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: expected JSON with offset, slope and ratios, could not read it ({error})") from error
    shapes = found.offset.ndim == found.ratios.ndim == 1 and found.slope.shape == (len(Signs._fields),)
    if not shapes or not all(np.isfinite(values).all() for values in vars(found).values()):
        raise InputError(f"{path}: expected finite numbers, {len(Signs._fields)} of them in slope")
    return found


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ModelError:
    """A term of the objective: the expected error of a plan's predicted outcome [cloth length]."""

    weight: Scalar
    error: ExpectedError
    support: SupportModel
    model: ForwardModel = field(metadata={"static": True})
    net: int = field(default=0, metadata={"static": True})
    """Index of the net whose latents the support model was trained with."""
    every_step: ClassVar[bool] = False

    def __call__(self, outlook: Outlook) -> Float[Array, " strains"]:
        plan = jnp.swapaxes(outlook.plan, 0, 1)
        found = surprise(self.support, inputs(self.model, outlook.latents[self.net], plan))
        measures = measure(outlook.outcomes)
        last = len(plan) - 1 if outlook.steps is None else outlook.last
        count = len(plan) if outlook.steps is None else outlook.steps
        return self.error(Signs(measures.distance, measures.sigma, count * outlook.mean(found)), last)
