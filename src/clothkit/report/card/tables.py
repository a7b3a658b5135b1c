"""Tables of the card: group-bys of its tidy rows. Values are in the measures' units for people."""

from collections.abc import Mapping, Sequence
from itertools import islice

import numpy as np
import pandas as pd

from clothkit.cloth.voxels import HEIGHT
from clothkit.report.card.inputs import Inputs
from clothkit.report.card.measures import QUALITY, SHAPE, WORST, Measure, of_name

STEPS = (1, 2, 3)
TOLERANCE = 0.05
"""How far the medians of accepted states may lie from those of tried ones: limits that reject more than that would
make the data easier than the folds that were tried."""

WITHIN = f"within {100 * TOLERANCE:.0f} %"


def outcomes(attempts: pd.DataFrame) -> pd.DataFrame:
    """What became of tried sequences, and after which manipulation: counts and shares, most frequent first."""
    outcome = attempts["reason"].where(~attempts["accepted"].astype(bool), "accepted")
    # A rejected state is the last that was reached; where no manipulation was found there is none.
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
    """Manipulations, single-handed ones and their share, by step and in all."""
    single = manipulations["hands"] == 1
    groups = [(str(k), manipulations["step"] == k - 1) for k in STEPS]
    groups = [(name, of) for name, of in groups if of.any()] + [("all", pd.Series(True, manipulations.index))]
    rows = [(name, int(of.sum()), int((single & of).sum()), 100 * float(single[of].mean())) for name, of in groups]
    return pd.DataFrame(rows, columns=["step", "manipulations", "single-handed", "share [%]"])


def quality(states: pd.DataFrame, limits: Mapping[str, float]) -> pd.DataFrame:
    """Median, 5 %, 95 % and worst of every measure after each step, and the limit of acceptance where there is one."""
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
    """How far accepted and tried states are folded: medians (and means) after each step, and how they differ."""
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


def viewport(tried: pd.DataFrame) -> pd.DataFrame:
    """How many tried states stand higher than the viewport of the voxels, after each step."""
    rows = []
    for k in STEPS:
        height = tried.loc[tried["state"] == k, "height"].dropna()
        higher = int((height > HEIGHT).sum())
        rows.append((k, len(height), higher, 100 * higher / len(height) if len(height) else np.nan))
    return pd.DataFrame(rows, columns=["step", "tried states", "higher", "share [%]"])


def worst(states: pd.DataFrame, *, count: int) -> pd.DataFrame:
    """The `count` worst states by each measure of WORST, no state twice: sequence, state, measure, rank, value.

    A state that is already there for another measure gives way to the next. Values are in the files' units.
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
    """The numbers of `count` sequences, drawn at random without repetition, in order."""
    present = states["sequence"].unique()
    chosen = np.random.default_rng(seed).choice(len(present), min(count, len(present)), replace=False)
    return sorted(int(present[place]) for place in chosen)


def spread(values: pd.Series, measure: Measure) -> Sequence[float]:
    """The values that are there, in the measure's unit for people."""
    return (values.dropna() * measure.factor).tolist()


def _relative(value: float, reference: float) -> float:
    return 0.0 if value == reference else (value / reference - 1 if reference else np.nan)
