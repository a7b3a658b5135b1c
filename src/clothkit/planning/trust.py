"""Trust: what becomes of plans with an expectation such as a plan's, as executed validation plans tell it.

The planner expects a distance of its predicted outcome from the goal, an error of this prediction (`model_error`), and
its perception is unsure of the state that it starts from. From these, a map that was fitted to executed plans
(`error_map`) gives the expected distance of the real outcome from the goal.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from clothkit.planning import error_map
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.types import Plan
from clothkit.planning.uncertainty_terms import Measure

PLACE = "normalisation/trust.json"
"""Place of the map, under the folder of all artifacts."""

NEAR = 0.05
"""Distance of an outcome from its goal up to which a plan came true [cloth length]."""

INTERVAL = 0.8
"""Share of outcomes between `low` and `high`."""

_LEAST = {"expected": 0.002, "model_error": 0.002, "sigma": 0.002}


class Signs(NamedTuple):
    """What tells how a plan will end [cloth length]."""

    expected: Float[np.ndarray, " task"]
    """Distance of the predicted outcome from the goal."""
    model_error: Float[np.ndarray, " task"]
    """Expected error of the predicted outcome; NaN where the planner has no such measure."""
    sigma: Float[np.ndarray, " task"]
    """How unsure the perception is of the state that the plan starts from, with what was predicted of it taken into
    account; 0 where it is known."""


class Trusted(NamedTuple):
    """What plans with such an expectation came to."""

    error: Float[np.ndarray, " task"]
    """Their mean distance from the goal [cloth length]."""
    low: Float[np.ndarray, " task"]
    """INTERVAL of them ended between these distances."""
    high: Float[np.ndarray, " task"]
    trust: Float[np.ndarray, " task"]
    """The share of them that came true: that ended at most NEAR from the goal."""


def signs_of(plan: Plan, sigma: Float[np.ndarray, " task"], measure: Measure) -> Signs:
    """Return the signs of plans whose planner has that measure of uncertainty."""
    unknown = np.full(len(plan.expected), np.nan)
    return Signs(plan.expected, plan.terms.get("uncertainty", unknown) if measure == "expected" else unknown, sigma)


def names_of(measure: Measure) -> tuple[str, ...]:
    """Return the names of the signs that planners with that measure have."""
    return Signs._fields if measure == "expected" else ("expected", "sigma")


def least_of(names: tuple[str, ...]) -> tuple[float, ...]:
    """Return what is added to these signs before their logarithm is taken [cloth length]."""
    return tuple(_LEAST[name] for name in names)


def tells(trust: ErrorMap, signs: Signs) -> bool:
    """Return whether a map can tell of plans with such signs: none is missing that it needs."""
    return all(bool(np.isfinite(getattr(signs, name)).all()) for name in trust.signs)


def trusted(trust: ErrorMap, signs: Signs, length: Int[np.ndarray, " task"]) -> Trusted:
    """Return what plans of that many manipulations with such signs came to."""
    return of_error(trust, np.asarray(trust([getattr(signs, name) for name in trust.signs], length - 1)))


def ends_worse(
    trust: ErrorMap, signs: Signs, length: Int[np.ndarray, " task"], now: Float[np.ndarray, " task"]
) -> Bool[np.ndarray, " task"]:
    """Return whether plans with such signs ended farther from their goals, in the mean, than `now`.

    `now` are the distances of the cloths as they lie [cloth length]. False where the map can't tell of the plans.
    """
    told = np.all([np.isfinite(getattr(signs, name)) for name in trust.signs], axis=0)
    return told & (trusted(trust, signs, length).error > now)


def load(path: Path) -> ErrorMap:
    """Read the map. Raises InputError for a file that is missing, damaged, or holds another map."""
    return error_map.load(path, Signs._fields, some=True)


def of_error(trust: ErrorMap, error: Float[np.ndarray, " task"]) -> Trusted:
    """Return what plans with that expected distance from the goal came to."""
    return Trusted(error, *trust.interval(error, INTERVAL), trust.share_below(NEAR, error))
