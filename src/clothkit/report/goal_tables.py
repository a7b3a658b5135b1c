"""Tables of plans for named goals: means over repeats, and those of doing nothing beside them."""

import pandas as pd

from clothkit.report.layout import GOALS, NO_ACTION, STARTS


def goals(tidy: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Means of a measure by goal and source.

    Columns: goal, manipulations (that the goal needs), source (of the state; script: the goal's own folds; no action),
    cloths (number), and one per start: flat, dragged, crumpled.
    """
    planned = tidy[tidy["source"] != "script"]
    nothing = (planned if len(planned) else tidy).assign(source=NO_ACTION, **{measure: tidy[f"{measure}_no_action"]})
    rows = pd.concat([tidy, nothing], ignore_index=True)
    means = rows.groupby(["goal", "manipulations", "source", "start"], sort=False)[measure].mean().unstack()
    means.insert(0, "cloths", rows.groupby(["goal", "manipulations", "source"], sort=False)["repeat"].nunique())
    found = means.reset_index().reindex(columns=list(GOALS))
    order = {name: place for place, name in enumerate(dict.fromkeys(tidy["goal"]))}
    sources = {name: place for place, name in enumerate(dict.fromkeys(rows["source"]))}
    ranks = found["goal"].map(order) * len(sources) + found["source"].map(sources)
    return found.iloc[ranks.argsort(kind="stable")].dropna(subset=list(STARTS), how="all").reset_index(drop=True)
