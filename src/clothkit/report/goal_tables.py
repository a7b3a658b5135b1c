"""Tables of plans for named goals: means over repeats and their spread, and those of doing nothing beside them."""

import pandas as pd

from clothkit.report.layout import GOALS, GOALS_SPREAD, NO_ACTION, STARTS


def goals(tidy: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Means of a measure by goal and source, and its standard deviations over cloths.

    Columns: goal, manipulations (that the goal needs), source (of the state; script: the goal's own folds; no action),
    cloths (number), one per start with the mean: flat, dragged, crumpled; and one per start with the standard deviation
    (n - 1): flat_std, dragged_std, crumpled_std, NaN of a single cloth.
    """
    planned = tidy[tidy["source"] != "script"]
    # A cloth that is planned for from several sources lies there once.
    lying = (planned if len(planned) else tidy).drop_duplicates(["goal", "start", "repeat"])
    nothing = lying.assign(source=NO_ACTION, **{measure: tidy[f"{measure}_no_action"]})
    rows = pd.concat([tidy, nothing], ignore_index=True)
    by_start = rows.groupby(["goal", "manipulations", "source", "start"], sort=False)[measure]
    means = by_start.mean().unstack().join(by_start.std().unstack().add_suffix("_std"))
    means.insert(0, "cloths", rows.groupby(["goal", "manipulations", "source"], sort=False)["repeat"].nunique())
    found = means.reset_index().reindex(columns=[*GOALS, *GOALS_SPREAD])
    order = {name: place for place, name in enumerate(dict.fromkeys(tidy["goal"]))}
    sources = {name: place for place, name in enumerate(dict.fromkeys(rows["source"]))}
    ranks = found["goal"].map(order) * len(sources) + found["source"].map(sources)
    return found.iloc[ranks.argsort(kind="stable")].dropna(subset=list(STARTS), how="all").reset_index(drop=True)
