"""What tells where forward models are wrong: how well each measure of uncertainty ranks the errors of probes."""

from collections.abc import Callable, Iterator

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from scipy.stats import rankdata, spearmanr

MEASURES = ("deviations", "conditional", "distance", "sigma", "surprise", "expected")
"""Columns of probes that tell of doubt: u_i of eq. (15), z_i of the measure `conditional`, the nets' distance, sigma,
surprise, the expected error."""

WRONG = 0.08
"""A prediction with a larger error is wrong [cloth length]: as far off as predictions of a third manipulation."""

DRAWS = 300
"""Bootstrap samples, of sequences."""

ON_SUPPORT = "recorded"


def auroc(measure: Float[np.ndarray, " rows"], positive: Bool[np.ndarray, " rows"]) -> float:
    """Return the probability that the measure of a positive row is above that of a negative one; ties count half.

    NaN without rows of both kinds.
    """
    count = int(positive.sum())
    if count in (0, len(positive)):
        return float("nan")
    above = rankdata(measure)[positive].sum() - count * (count + 1) / 2
    return float(above / (count * (len(positive) - count)))


def rank_correlation(measure: Float[np.ndarray, " rows"], error: Float[np.ndarray, " rows"]) -> float:
    """Return Spearman's rank correlation; NaN if either is constant."""
    if len(measure) == 0 or np.ptp(measure) == 0 or np.ptp(error) == 0:
        return float("nan")
    return float(spearmanr(measure, error).statistic)


STATISTICS: dict[str, Callable[[np.ndarray, np.ndarray, np.ndarray], float]] = {
    "wrong": lambda measure, error, on_support: auroc(measure, error > WRONG),
    "off_support": lambda measure, error, on_support: auroc(measure, ~on_support),
    "rank": lambda measure, error, on_support: rank_correlation(measure, error),
}
"""wrong: AUROC for errors above WRONG; off_support: AUROC for manipulations unlike recorded ones; rank: correlation
with the error."""


def groups(rows: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield all probes, those of one manipulation by start state, and those of each step."""
    yield "all", rows
    for start, own in rows[rows["step"] == 1].groupby("start"):
        yield f"start {start}", own
    for step, own in rows.groupby("step"):
        yield f"step {step}", own


def summary(rows: pd.DataFrame, *, seed: int = 0) -> pd.DataFrame:
    """Return a row per measure, group and statistic: value, and a 95 % bootstrap interval over sequences.

    `rows` are those of `probes.table`. Measures that a single net does not have are left out.
    """
    # The first manipulation of a random plan is drawn on the support.
    rows = rows.assign(on_support=(rows["kind"] == ON_SUPPORT) | ((rows["kind"] == "random") & (rows["step"] == 1)))
    rng, found = np.random.default_rng(seed), []
    sequences = rows["sequence"].unique()
    draws = [rng.choice(sequences, len(sequences)) for _ in range(DRAWS)]
    measures = [measure for measure in MEASURES if rows[measure].notna().all() and rows[measure].nunique() > 1]
    for group, own in groups(rows):
        of_sequence = own.groupby("sequence").indices
        nowhere = np.zeros(0, int)
        samples = [np.concatenate([of_sequence.get(s, nowhere) for s in draw]) for draw in draws]
        columns = [own[name].to_numpy() for name in ("error", "on_support")]
        for measure in measures:
            values = own[measure].to_numpy()
            for name, statistic in STATISTICS.items():
                drawn = [statistic(values[sample], *(part[sample] for part in columns)) for sample in samples]
                low, high = np.nanquantile(drawn, [0.025, 0.975]) if np.isfinite(drawn).any() else (np.nan, np.nan)
                value = statistic(values, *columns)
                found.append(
                    {"measure": measure, "group": group, "statistic": name, "value": value, "low": low, "high": high}
                )
    return pd.DataFrame(found)
