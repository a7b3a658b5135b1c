"""Tables of what tells where forward models are wrong, and of how far plans' expectations came true."""

from itertools import pairwise

import numpy as np
import pandas as pd

from clothkit.planning.error_map import LEAST
from clothkit.planning.trust import NEAR
from clothkit.report.layout import PROBED

BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Bounds of the classes of trust."""


def doubt(summary: pd.DataFrame) -> pd.DataFrame:
    """The statistics of `doubt.summary` with a column per group of probes; columns statistic, measure and PROBED."""
    wide = summary.pivot_table(index=["statistic", "measure"], columns="group", values="value", sort=False)
    return wide.reset_index().reindex(columns=["statistic", "measure", *PROBED])


def inside(rows: pd.DataFrame) -> pd.Series:
    """Whether each error is inside the interval that is told with its plan; errors below LEAST count as LEAST."""
    return rows["error"].clip(lower=LEAST).between(rows["trusted_low"], rows["trusted_high"])


def trust(rows: pd.DataFrame) -> pd.DataFrame:
    """How far validation plans came true by classes of what was expected of them, by the other sequences' plans.

    Columns: trust (the class), plans (number), expected and error (means [cloth length]), trusted and came_true (mean
    expected share and real share of plans that ended at most NEAR from their goals), inside (share of errors inside the
    interval).
    """
    rows = rows.dropna(subset=["trusted_error"])
    whole = rows.assign(**{"class": "all"})
    names = [f"{low:g} to {high:g}" for low, high in pairwise(BINS)]
    place = np.clip(np.searchsorted(BINS, rows["trusted_trust"].to_numpy(), side="right") - 1, 0, len(names) - 1)
    judged = pd.concat([rows.assign(**{"class": np.array(names)[place]}), whole])
    judged = judged.assign(
        came_true=judged["error"] <= NEAR,
        inside=inside(judged),
    )
    means = judged.groupby("class", as_index=False).agg(
        plans=("error", "size"),
        expected=("trusted_error", "mean"),
        error=("error", "mean"),
        trusted=("trusted_trust", "mean"),
        came_true=("came_true", "mean"),
        inside=("inside", "mean"),
    )
    order = {name: number for number, name in enumerate((*names, "all"))}
    means = means.rename(columns={"class": "trust"})
    return means.sort_values("trust", key=lambda names: names.map(order), ignore_index=True)
