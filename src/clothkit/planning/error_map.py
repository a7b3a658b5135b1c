"""A monotone map from signs of doubt to an expected error, learned from executed manipulations.

log e = offset_step + slope . log(signs), with slopes that are not negative: the error grows as a power of each sign. It
is fitted by least squares in logarithms, and its mean is made that of the data by one factor (Duan, "Smearing
estimate", 1983), since a mean in logarithms is a median of errors. Around what is expected, errors scatter by factors
that depend on it: quantiles of these are those of the executed manipulations of about that expectation.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.optimize import lsq_linear

from clothkit.runtime.errors import InputError
from clothkit.runtime.json_file import read_json

Values = Float[Array | np.ndarray, "*batch"] | float

LEAST = 1e-3
"""Least error of which a logarithm is taken [cloth length]."""

RIDGE = 1e-4
"""Weight of squared slopes beside the mean square that is fitted, so that a sign that is always the same has none."""

LEVELS = 3
"""So many levels of expected errors have quantiles of their own, if there are rows enough."""

ROWS = 30
"""Least number of rows of a level."""

_NUMBERS = ("least", "offset", "slope", "levels", "ratios")
_ONE_LEVEL = (1.0,)
"""Levels of files of older versions, which have one list of quantiles."""


_interpolated = np.vectorize(np.interp, otypes=[float], signature="(),(points),(points)->()")
"""np.interp at a place of each row."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ErrorMap:
    """A fitted map."""

    signs: tuple[str, ...] = field(metadata={"static": True})
    """Names of the signs, in the order in which they are given."""
    least: Float[Array | np.ndarray, " signs"]
    """Added to each sign before its logarithm is taken: beyond that, it tells nothing."""
    offset: Float[Array | np.ndarray, " steps"]
    """By the number of manipulations, less one."""
    slope: Float[Array | np.ndarray, " signs"]
    levels: Float[Array | np.ndarray, " levels"]
    """Expected errors at which quantiles are known, rising [cloth length]."""
    ratios: Float[Array | np.ndarray, "levels quantiles"]
    """Quantiles 0, 1 / n .. 1 of true errors, relative to the expected ones. Between levels they are interpolated."""

    def __call__(self, signs: Sequence[Values], step: int | Int[Array | np.ndarray, "..."]) -> Float[Array, "*batch"]:
        """Return the expected error after step + 1 manipulations [cloth length]."""
        powers = [a * jnp.log(sign + b) for a, sign, b in zip(self.slope, signs, self.least, strict=True)]
        return jnp.exp(jnp.asarray(self.offset)[step] + sum(powers))

    def interval(self, expected: Values, share: float = 0.8) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds between which that share of the errors lies, for errors that are expected."""
        ratios = self._ratios_at(expected)
        low, high = (_interpolated(end, self._shares, ratios) for end in ((1 - share) / 2, (1 + share) / 2))
        return np.asarray(expected * low), np.asarray(expected * high)

    def share_below(self, limit: float, expected: Values) -> np.ndarray:
        """Return the share of the errors that are at most `limit`, for errors that are expected."""
        return np.asarray(_interpolated(limit / np.asarray(expected), self._ratios_at(expected), self._shares))

    def _ratios_at(self, expected: Values) -> Float[np.ndarray, "*batch quantiles"]:
        """The quantiles for errors that are expected; beyond the levels, those of the nearest one."""
        levels, ratios = np.asarray(self.levels), np.asarray(self.ratios)
        # Of what is not known (NaN), no more is known by any level.
        place = np.nan_to_num(np.interp(np.log(np.asarray(expected)), np.log(levels), np.arange(len(levels))))
        below = np.minimum(place.astype(int), max(len(levels) - 2, 0))
        part = (place - below)[..., None]
        return (1 - part) * ratios[below] + part * ratios[np.minimum(below + 1, len(levels) - 1)]

    @property
    def _shares(self) -> Float[np.ndarray, " quantiles"]:
        return np.linspace(0, 1, np.shape(self.ratios)[-1])


def fit(
    signs: dict[str, Float[np.ndarray, " rows"]],
    least: Sequence[float],
    step: Int[np.ndarray, " rows"],
    error: Float[np.ndarray, " rows"],
    quantiles: int = 20,
) -> ErrorMap:
    """Fit the map to the signs of predictions, manipulations so far less one, and true errors [cloth length].

    Raises ValueError for a step before the last one without rows.
    """
    steps = int(step.max()) + 1
    if missing := set(range(steps)) - set(step.tolist()):
        raise ValueError(f"expected rows of every step, found none of step {min(missing)}")
    logarithms = np.log(np.stack(list(signs.values()), axis=-1) + np.asarray(least))
    columns = np.concatenate([np.eye(steps)[step], logarithms], axis=-1)
    true = np.maximum(error, LEAST)
    bounds = (np.concatenate([np.full(steps, -np.inf), np.zeros(len(signs))]), np.inf)
    ridge = (RIDGE * len(true)) ** 0.5 * np.eye(steps + len(signs))[steps:]
    sides = np.concatenate([columns, ridge]), np.concatenate([np.log(true), np.zeros(len(signs))])
    found = lsq_linear(*sides, bounds, method="bvls").x
    ratio = true / np.exp(columns @ found)
    mean = ratio.mean()
    spread = _spread(true / ratio * mean, ratio / mean, np.linspace(0, 1, quantiles + 1))
    return ErrorMap(tuple(signs), np.array(least, float), found[:steps] + np.log(mean), found[steps:], *spread)


def _spread(
    expected: Float[np.ndarray, " rows"], ratio: Float[np.ndarray, " rows"], shares: Float[np.ndarray, " quantiles"]
) -> tuple[Float[np.ndarray, " levels"], Float[np.ndarray, "levels quantiles"]]:
    """Return levels of expected errors, each of as many rows, and the quantiles of their rows' ratios."""
    rows = np.argsort(expected, kind="stable")
    for count in range(max(1, min(LEVELS, len(rows) // ROWS)), 0, -1):
        parts = np.array_split(rows, count)
        levels = np.exp([np.log(expected[part]).mean() for part in parts])
        if (np.diff(levels) > 0).all():
            break
    # Of few rows, the quantiles between which a further one lies with the wanted probability are a little wider.
    return levels, np.stack([np.quantile(ratio[part], shares, method="weibull") for part in parts])


FOLDS = 5


def expected_by_others(
    signs: dict[str, Float[np.ndarray, " rows"]],
    least: Sequence[float],
    step: Int[np.ndarray, " rows"],
    error: Float[np.ndarray, " rows"],
    sequence: Int[np.ndarray, " rows"],
) -> Float[np.ndarray, " rows"]:
    """Return the error of each row that is expected by a map fitted to other sequences (cross-validation).

    NaN where other sequences have no row of some step.
    """
    expected = np.full(len(error), np.nan)
    for own, fitted in fitted_to_others(signs, least, step, error, sequence):
        expected[own] = np.asarray(fitted([values[own] for values in signs.values()], step[own]))
    return expected


def fitted_to_others(
    signs: dict[str, Float[np.ndarray, " rows"]],
    least: Sequence[float],
    step: Int[np.ndarray, " rows"],
    error: Float[np.ndarray, " rows"],
    sequence: Int[np.ndarray, " rows"],
) -> Iterator[tuple[Bool[np.ndarray, " rows"], ErrorMap]]:
    """Yield parts of the rows, each with the map fitted to the rows of the sequences that it has no row of.

    Parts for which other sequences have no row of some step are left out.
    """
    fold = np.searchsorted(np.unique(sequence), sequence) % FOLDS
    for k in range(FOLDS):
        own, others = fold == k, fold != k
        if own.any() and set(step[own]) <= set(step[others]) == set(range(int(step[others].max()) + 1)):
            found = fit({name: values[others] for name, values in signs.items()}, least, step[others], error[others])
            yield own, found


def save(path: Path, found: ErrorMap, attributes: dict[str, Any]) -> None:
    """Write a map and the attributes (the params that it was made with) as JSON."""
    numbers = {name: np.asarray(getattr(found, name)).tolist() for name in _NUMBERS}
    path.write_text(json.dumps({"signs": found.signs, **numbers, "attributes": attributes}, indent=1) + "\n")


def load(path: Path, signs: tuple[str, ...], *, some: bool = False) -> ErrorMap:
    """Read a map of these signs or, with `some`, of some of them.

    Raises InputError for a file that is missing, damaged, or holds another map.
    """
    wanted = f"JSON with {', '.join(('signs', *_NUMBERS))}"
    stored = read_json(path, expected=f"{wanted}; run the stage that writes it (dvc repro)")
    try:
        stored = {"levels": _ONE_LEVEL, **stored}
        named, numbers = tuple(stored["signs"]), {name: np.array(stored[name], float) for name in _NUMBERS}
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: expected {wanted}, could not read it ({error})") from error
    if named != (tuple(name for name in signs if name in named) if some else signs):
        raise InputError(f"{path}: expected a map of {', '.join(signs)}, found one of {', '.join(map(str, named))}")
    numbers["ratios"] = np.atleast_2d(numbers["ratios"])
    dimensions = {name: 1 + (name == "ratios") for name in _NUMBERS}
    lists = all(
        values.ndim == dimensions[name] and values.size and np.isfinite(values).all()
        for name, values in numbers.items()
    )
    if not lists or {len(numbers["least"]), len(numbers["slope"])} != {len(named)} or (numbers["least"] <= 0).any():
        raise InputError(f"{path}: expected lists of finite numbers, a slope and a least value above 0 for each sign")
    levels = numbers["levels"]
    if len(levels) != len(numbers["ratios"]) or (levels <= 0).any() or (np.diff(levels) <= 0).any():
        raise InputError(f"{path}: expected levels above 0 that rise, and a list of ratios for each")
    return ErrorMap(named, **numbers)
