"""Paired comparisons of systems on the same tasks: intervals and tests of mean differences.

The tasks of a sequence share its states, so sequences, not tasks, are treated as independent and are resampled.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from clothkit.dataset.store import STEPS

DRAWS = 10_000
"""Number of bootstrap resamples, and of random sign flips of a test."""

CONFIDENCE = 0.95

LEAST = 10
"""Fewest sequences for which an interval or a p is computed."""

KEYS = ["sequence", "start", "length"]

COLUMNS = ("split", "measure", "system", "against", "column", "sequences", "difference", "low", "high", "p")
"""Columns of the rows of `compare`."""

_TYPES = {
    **dict.fromkeys(("split", "measure", "system", "against", "column"), "str"),
    "sequences": "int64",
    **dict.fromkeys(("difference", "low", "high", "p"), "float64"),
}


def interval(
    total: Float[np.ndarray, " n"], count: np.ndarray, *, seed: int = 0, draws: int = DRAWS
) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of sum(total) / sum(count), the mean over tasks.

    `total` and `count` are each sequence's sum and number of values; sequences are resampled. Returns NaN for fewer
    than `LEAST` sequences.
    """
    if len(total) < LEAST:
        return float("nan"), float("nan")
    picked = np.random.default_rng(seed).integers(len(total), size=(draws, len(total)))
    means = total[picked].sum(1) / count[picked].sum(1)
    low, high = np.quantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def sign_flip(total: Float[np.ndarray, " n"], *, seed: int = 0, draws: int = DRAWS) -> float:
    """Return the two-sided p of a paired permutation test by random sign flips.

    `total` is each sequence's sum of differences; under the null hypothesis both signs are equally likely. p is the
    fraction of random signs whose sum is at least as far from zero as the observed one, and at least 1 / (draws + 1).
    Returns NaN for fewer than `LEAST` sequences.
    """
    if len(total) < LEAST:
        return float("nan")
    signs = np.random.default_rng(seed).integers(2, size=(draws, len(total))) * 2.0 - 1
    found = abs(total.sum())
    # The tolerance counts sums that differ only by rounding as equal.
    as_far = np.abs(signs @ total) >= found * (1 - 1e-9)
    return float((1 + as_far.sum()) / (draws + 1))


class Totals(NamedTuple):
    """Sums per sequence for one split and one column of the tables."""

    split: str
    column: str
    """length/start, with `all` in place of the start for all starts together."""
    total: Float[np.ndarray, " n"]
    """Each sequence's sum of a measure over its tasks."""
    tasks: Int[np.ndarray, " n"]
    """Each sequence's number of tasks."""

    @property
    def mean(self) -> float:
        """The mean over tasks."""
        return float(self.total.sum() / self.tasks.sum())


def totals(tidy: pd.DataFrame, measure: str) -> list[Totals]:
    """Return the sums of the column `measure` of tidy rows, per split and column of the tables."""
    length = tidy["length"].astype(str)
    # Tasks of three manipulations have a single start, which the tables call `all`.
    labels = ((length + "/" + tidy["start"].astype(str)).where(tidy["length"] < STEPS), length + "/all")
    found = []
    for label in labels:
        for (split, column), rows in tidy.groupby(["split", label]):
            by_sequence = rows.groupby("sequence")[measure].agg(["sum", "count"])
            total, tasks = by_sequence["sum"].to_numpy(np.float64), by_sequence["count"].to_numpy()
            found.append(Totals(str(split), str(column), total, tasks))
    return sorted(found, key=lambda part: (part.split, part.column))


def compare(tidy: pd.DataFrame, measure: str, system: str, against: str, *, seed: int = 0) -> pd.DataFrame:
    """Compare two systems by a column of tidy rows, in pairs; return a row per split and column of the tables.

    The columns are split, measure, system, against, column (length/start, or length/all), sequences, difference (mean
    of `measure` of `system` minus that of `against`, over the tasks that both have), low, high (95 % bootstrap
    interval), p (two-sided sign-flip test). The last three are NaN for fewer than `LEAST` sequences.
    """
    one, other = (
        tidy.loc[tidy["system"] == name, ["split", *KEYS, measure]].set_index(["split", *KEYS])[measure]
        for name in (system, against)
    )
    pairs = (one - other).dropna().rename("difference").reset_index()
    found = []
    for part in totals(pairs, "difference"):
        low, high = interval(part.total, part.tasks, seed=seed)
        p = sign_flip(part.total, seed=seed)
        row = (part.split, measure, system, against, part.column, len(part.total), part.mean, low, high, p)
        found.append(row)
    # Types are told, since those of a table without rows can't be seen from it.
    return pd.DataFrame(found, columns=list(COLUMNS)).astype(_TYPES)


def of_predictions(tidy: pd.DataFrame) -> pd.DataFrame:
    """Return the comparisons for table 4: system main_occluded against a2, by voxel_error, with the best net of each.

    Both predict voxels as a camera above would see them.
    """
    return compare(tidy[tidy["better"]], "voxel_error", "main_occluded", "a2")
