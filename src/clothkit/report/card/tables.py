"""Tables of the card: group-bys of its tidy rows. Values are in the measures' units for display."""

from collections.abc import Mapping, Sequence
from itertools import islice

import numpy as np
import pandas as pd

from clothkit.report.card.inputs import Inputs
from clothkit.report.card.measures import QUALITY, SHAPE, WORST, Measure, of_name

STEPS = (1, 2, 3)
TOLERANCE = 0.05
"""Largest relative difference between medians of accepted and of tried states.

A larger one means that the limits of acceptance reject difficult folds, which makes the data too easy.
"""

WITHIN = f"within {100 * TOLERANCE:.0f} %"


def outcomes(attempts: pd.DataFrame) -> pd.DataFrame:
    """Outcomes of tried sequences and the manipulation at which they ended: counts and shares, most frequent first."""
    outcome = attempts["reason"].where(~attempts["accepted"].astype(bool), "accepted")
    # A sequence ends with its rejected state, except when no manipulation was found: then no state was rejected.
    step = attempts["states"] - (outcome != "no manipulation")
    counts = pd.crosstab(outcome, step).reindex(columns=list(STEPS), fill_value=0)
    total = outcome.value_counts()
    table = pd.DataFrame({"outcome": total.index, "attempts": total.to_numpy()})
    table = table.sort_values(["attempts", "outcome"], ascending=[False, True], ignore_index=True)
    table["share [%]"] = 100 * table["attempts"] / len(attempts)
    for k in STEPS:
        table[f"at step {k}"] = counts.loc[table["outcome"], k].to_numpy()
    return table


def hands(manipulations: pd.DataFrame) -> pd.DataFrame:
    """Numbers of manipulations and of single-handed ones, and the share of these, by step and in total."""
    single = manipulations["hands"] == 1
    groups = [(str(k), manipulations["step"] == k - 1) for k in STEPS]
    groups = [(name, of) for name, of in groups if of.any()] + [("all", pd.Series(True, manipulations.index))]
    rows = [(name, int(of.sum()), int((single & of).sum()), 100 * float(single[of].mean())) for name, of in groups]
    return pd.DataFrame(rows, columns=["step", "manipulations", "single-handed", "share [%]"])


def quality(states: pd.DataFrame, limits: Mapping[str, float]) -> pd.DataFrame:
    """Median, 5 %, 95 % and worst value of every measure after each step, and the limit of acceptance, if any."""
    rows = []
    for measure in QUALITY:
        for k in STEPS:
            values = states.loc[states["state"] == k, measure.name].dropna() * measure.factor
            low, median, high = values.quantile([0.05, 0.5, 0.95])
            limit = limits.get(measure.name, np.nan) * measure.factor
            worst = values.agg(measure.worst) if len(values) else np.nan
            rows.append((measure.title, k, len(values), median, low, high, worst, limit))
    return pd.DataFrame(rows, columns=["measure", "step", "states", "median", "5 %", "95 %", "worst", "limit"])


def against_tried(inputs: Inputs) -> pd.DataFrame:
    """Medians and means of SHAPE over accepted and tried states by step, and the medians' relative difference."""
    rows = []
    for measure in SHAPE:
        for k in STEPS:
            both = [table.loc[table["state"] == k, measure.name].dropna() for table in (inputs.states, inputs.tried)]
            (accepted, tried), means = (values.median() for values in both), [values.mean() for values in both]
            differ = _relative(accepted, tried)
            within = "–" if pd.isna(differ) else "yes" if abs(differ) <= TOLERANCE else "no"
            rows.append((measure.title, k, accepted, tried, 100 * differ, within, *means))
    columns = ["accepted, median", "tried, median", "difference [%]", WITHIN, "accepted, mean", "tried, mean"]
    return pd.DataFrame(rows, columns=["measure", "step", *columns])


def viewport(tried: pd.DataFrame, highest: float) -> pd.DataFrame:
    """Number and share of tried states that are higher than `highest` [normalised], after each step."""
    rows = []
    for k in STEPS:
        height = tried.loc[tried["state"] == k, "height"].dropna()
        higher = int((height > highest).sum())
        rows.append((k, len(height), higher, 100 * higher / len(height) if len(height) else np.nan))
    return pd.DataFrame(rows, columns=["step", "tried states", "higher", "share [%]"])


def worst(states: pd.DataFrame, *, count: int) -> pd.DataFrame:
    """The `count` worst states by each measure of WORST, no state twice: sequence, state, measure, rank, value.

    A state that was chosen for an earlier measure is skipped. Values are in the files' units.
    """
    taken: set[tuple[int, int]] = set()
    rows = []
    for name in WORST:
        ascending = of_name(name).worst == "min"
        order = states[states["state"] > 0].dropna(subset=[name]).sort_values(name, ascending=ascending, kind="stable")
        ranked = enumerate(zip(order["sequence"], order["state"], order[name], strict=True), start=1)
        fresh = ((int(q), int(k), rank, value) for rank, (q, k, value) in ranked if (int(q), int(k)) not in taken)
        for sequence, state, rank, value in list(islice(fresh, count)):
            taken.add((sequence, state))
            rows.append((sequence, state, name, rank, value))
    return pd.DataFrame(rows, columns=["sequence", "state", "measure", "rank", "value"])


def drawn(states: pd.DataFrame, *, count: int, seed: int) -> list[int]:
    """The numbers of `count` sequences that are drawn at random without replacement, sorted."""
    present = states["sequence"].unique()
    chosen = np.random.default_rng(seed).choice(len(present), min(count, len(present)), replace=False)
    return sorted(int(present[place]) for place in chosen)


def spread(values: pd.Series, measure: Measure) -> Sequence[float]:
    """The values that are not NaN, in the measure's unit for display."""
    return (values.dropna() * measure.factor).tolist()


def _relative(value: float, reference: float) -> float:
    return 0.0 if value == reference else (value / reference - 1 if reference else np.nan)
