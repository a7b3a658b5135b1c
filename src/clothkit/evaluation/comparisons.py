"""Whether one system is better than another on the same tasks: intervals and paired tests of mean differences.

Tasks of one sequence share its states, so sequences are what is resampled and what is independent, not tasks.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from clothkit.dataset.store import STEPS

DRAWS = 10_000
"""Resamples of a bootstrap, and random sign flips of a test."""

CONFIDENCE = 0.95

LEAST = 10
"""Sequences without which there is neither an interval nor a p: fewer tell too little."""

KEYS = ["sequence", "start", "length"]

COLUMNS = ("split", "measure", "system", "against", "column", "sequences", "difference", "low", "high", "p")
"""Of a paired comparison."""


def interval(
    total: Float[np.ndarray, " n"], count: np.ndarray, *, seed: int = 0, draws: int = DRAWS
) -> tuple[float, float]:
    """The 95 % bootstrap interval (percentiles) of sum(total) / sum(count): a mean over tasks, drawn by sequences.

    `total` and `count` are each sequence's sum and number of differences. NaN below `LEAST` sequences.
    """
    if len(total) < LEAST:
        return float("nan"), float("nan")
    picked = np.random.default_rng(seed).integers(len(total), size=(draws, len(total)))
    means = total[picked].sum(1) / count[picked].sum(1)
    low, high = np.quantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def sign_flip(total: Float[np.ndarray, " n"], *, seed: int = 0, draws: int = DRAWS) -> float:
    """Two-sided p of the paired permutation test: how often random signs give a sum as far from zero as the sum found.

    `total` is each sequence's sum of differences; under the null hypothesis its sign is as likely either way. Never
    below 1 / (draws + 1). NaN below `LEAST` sequences.
    """
    if len(total) < LEAST:
        return float("nan")
    signs = np.random.default_rng(seed).integers(2, size=(draws, len(total))) * 2.0 - 1
    found = abs(total.sum())
    # Sums that are equal but for rounding count as equal.
    as_far = np.abs(signs @ total) >= found * (1 - 1e-9)
    return float((1 + as_far.sum()) / (draws + 1))


class Totals(NamedTuple):
    """What a column of the tables sums up of one split, sequence by sequence."""

    split: str
    column: str
    """length/start, `all` for every start."""
    total: Float[np.ndarray, " n"]
    """Each sequence's sum of a measure over its tasks."""
    tasks: Int[np.ndarray, " n"]
    """How many it has."""

    @property
    def mean(self) -> float:
        """The mean over tasks."""
        return float(self.total.sum() / self.tasks.sum())


def totals(tidy: pd.DataFrame, measure: str) -> list[Totals]:
    """`measure` of tidy rows, per split and column of the tables."""
    length = tidy["length"].astype(str)
    # Three manipulations have one start only: the tables call it all.
    labels = ((length + "/" + tidy["start"].astype(str)).where(tidy["length"] < STEPS), length + "/all")
    found = []
    for label in labels:
        for (split, column), rows in tidy.groupby(["split", label]):
            by_sequence = rows.groupby("sequence")[measure].agg(["sum", "count"])
            total, tasks = by_sequence["sum"].to_numpy(np.float64), by_sequence["count"].to_numpy()
            found.append(Totals(str(split), str(column), total, tasks))
    return sorted(found, key=lambda part: (part.split, part.column))


def compare(tidy: pd.DataFrame, measure: str, system: str, against: str, *, seed: int = 0) -> pd.DataFrame:
    """Paired comparisons of two systems by a column of tidy rows, a row per split and column of the tables.

    split, measure, system, against, column (length/start, `all` for every start), sequences, difference (mean of
    `measure` of `system` minus that of `against`, over the tasks that both have), low, high (95 % bootstrap interval),
    p (two-sided sign-flip test). The last three are NaN below `LEAST` sequences.
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
    return pd.DataFrame(found, columns=list(COLUMNS))


def of_predictions(tidy: pd.DataFrame) -> pd.DataFrame:
    """The comparisons that table 4 is about: main, as a camera would see its predictions, against a2, whose are of that
    kind, by voxel difference, the better net of each."""
    return compare(tidy[tidy["better"]], "voxel_error", "main_occluded", "a2")
