"""Tables 2 to 5 in the paper's layout: group-bys of tidy rows, with the paper's figures below ours.

Every table has the columns source (clothkit, paper), split, kind or system, statistic (mean, std, median), then the
paper's columns. The system *no action* is the error between start and goal; the statistic *mean / no action* is the
ratio of a mean to it. Errors are in cloth lengths, except in table 4, which has mean voxel differences.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from clothkit.dataset.store import SPLITS, Dataset
from clothkit.report import paper, rows
from clothkit.report.layout import (
    HYPOTHESES,
    LENGTHS,
    NO_ACTION,
    NO_ACTION_OCCLUDED,
    RATIO,
    STATES,
    STATISTICS,
    TASKS,
)


def estimation(tidy: pd.DataFrame) -> pd.DataFrame:
    """Table 2. *No action* is the error of the state before the last manipulation, used as the estimate."""
    columns = [tidy["state"].astype(str), pd.Series("all", tidy.index)]
    table = _table(tidy, columns, STATES, by="kind", groups=("pmr", "dmr"))
    return pd.concat([table, paper.table(2)], ignore_index=True)


def prediction(tidy: pd.DataFrame, systems: Sequence[str]) -> pd.DataFrame:
    """Table 3, for the net with the best validation score. `tidy` has rows of every net."""
    rows.require(tidy, systems)
    table = task_table(tidy[tidy["better"]], systems)
    return pd.concat([table, paper.table_of(3, systems)], ignore_index=True)


def position(tidy: pd.DataFrame, systems: Sequence[str]) -> pd.DataFrame:
    """Table 5: error of the centre shift that the net with the best validation score predicts.

    *No action* is the error of a shift of 0.
    """
    rows.require(tidy, systems)
    chosen = tidy[tidy["better"] & tidy["system"].isin(list(systems))]
    measured = chosen.assign(error=chosen["position_error"], error_no_action=chosen["position_no_action"])
    table = _table(measured, [measured["length"].astype(str)], LENGTHS, by="system", groups=systems)
    return pd.concat([table, paper.table_of(5, systems)], ignore_index=True)


def prediction_voxels(tidy: pd.DataFrame, systems: Sequence[str], *, measure: str = "voxel_error") -> pd.DataFrame:
    """Table 4, for the net with the best validation score. `tidy` has rows of every net.

    The nets of a2 predict occluded voxels, so its truth and its *no action* are occluded, too (design 6.14). The system
    to compare it with is main_occluded. `measure` is voxel_error_025 for the viewport that is twice as high.
    """
    rows.require(tidy, systems)
    names = {system: NO_ACTION_OCCLUDED for system in systems if system in rows.VOXEL_SYSTEMS}
    table = task_table(tidy[tidy["better"]], systems, measure=measure, no_action=names)
    return pd.concat([table, paper.table_of(4, systems)], ignore_index=True)


def comparisons(tidy: pd.DataFrame) -> pd.DataFrame:
    """Paired comparisons, ordered by split and by the columns of table 3."""
    order = tidy.sort_values("column", key=lambda column: column.map(TASKS.index), kind="stable")
    return order.sort_values("split", kind="stable", ignore_index=True)


def task_table(
    tidy: pd.DataFrame, systems: Sequence[str], *, measure: str = "error", no_action: Mapping[str, str] | None = None
) -> pd.DataFrame:
    """Our rows of tables 3, 4, 6 and 7: statistics of a measure by length and start, with *no action*.

    `no_action` renames *no action* for systems whose starts and goals have another format than those of the others.
    """
    length = tidy["length"].astype(str)
    labels = [length + "/" + tidy["start"].astype(str), length + "/all"]
    return _table(tidy, labels, TASKS, by="system", groups=systems, measure=measure, no_action=no_action or {})


def sigma_ratio(estimates: pd.DataFrame, predictions: pd.DataFrame) -> pd.DataFrame:
    """Median sigma ratios of main; 0.798 is ideal.

    Columns: estimate (all states), estimate 1, 2 and 3 (states after so many manipulations; the paper tells them not),
    and 1, 2, 3: predictions after so many.
    """
    estimated = estimates[estimates["kind"] == "pmr"].groupby("split")["sigma_ratio"].median()
    by_state = estimates[estimates["kind"] == "pmr"].groupby(["split", "state"])["sigma_ratio"].median().unstack()
    by_state = by_state.set_axis([f"estimate {state}" for state in by_state.columns], axis=1)
    chosen = predictions[predictions["better"] & (predictions["system"] == "main")]
    predicted = chosen.groupby(["split", "length"])["sigma_ratio"].median().unstack()
    predicted.columns = [str(length) for length in predicted.columns]
    table = predicted.assign(estimate=estimated).join(by_state).reset_index()
    table = table.assign(source="clothkit", system="main")
    published = paper.sigma_ratios()
    first = ["source", "split", "system", "estimate", *by_state.columns]
    rest = [name for name in published.columns if name not in first]
    return pd.concat([table, published], ignore_index=True)[[*first, *rest]]


def hypotheses(tidy: pd.DataFrame) -> pd.DataFrame:
    """What several hypotheses of a state give, by split and state; empty if every state has one.

    Errors are those of refined meshes [cloth length]. Columns: split, state (1, 2, 3, all), states (their number),
    several (share of those with more than one distinct hypothesis), probability (mean, of the chosen hypothesis), error
    (of the chosen), best (of the hypothesis with the smallest error), and probability_several, error_several and
    best_several: the same of the states with several hypotheses.
    """
    rows = tidy[tidy["kind"] == "dmr"]
    if "hypotheses" not in rows or rows["hypotheses"].max() <= 1:
        return pd.DataFrame(columns=list(HYPOTHESES))
    counted = pd.concat([rows.assign(state=rows["state"].astype(str)), rows.assign(state="all")])
    measures = {"probability": "probability", "error": "error", "best": "error_best"}
    found = []
    for split in (split for split in SPLITS if split in set(rows["split"])):
        for state in STATES:
            own = counted[(counted["split"] == split) & (counted["state"] == state)]
            several = own[own["hypotheses"] > 1]
            means = [part[name].mean() for part in (own, several) for name in measures.values()]
            found.append((split, state, len(own), len(several) / max(len(own), 1), *means))
    return pd.DataFrame(found, columns=list(HYPOTHESES))


def _table(
    tidy: pd.DataFrame,
    labels: Sequence[pd.Series],
    columns: Sequence[str],
    *,
    by: str,
    groups: Sequence[str],
    measure: str = "error",
    no_action: Mapping[str, str] | None = None,
) -> pd.DataFrame:
    """Statistics of `measure`. Each series in `labels` assigns every row of `tidy` to a column of the table.

    `no_action` renames *no action* for groups whose starts and goals have another format than those of the others.
    """
    names = {group: (no_action or {}).get(group, NO_ACTION) for group in groups}
    counted = pd.concat([tidy.assign(column=label) for label in labels], ignore_index=True)
    keys = ["split", by, "column"]
    own = counted.groupby(keys)[measure].agg(list(STATISTICS)).reset_index()
    nones = counted.groupby(keys)[f"{measure}_no_action"].agg(list(STATISTICS)).reset_index()
    own = own.merge(nones[[*keys, "mean"]], on=keys, suffixes=("", "_none"))
    own[RATIO] = own["mean"] / own.pop("mean_none")
    # Groups with the same name of no action have the same starts and goals, so the first of them is used for all.
    first = {name: next(group for group in groups if names[group] == name) for name in names.values()}
    none = pd.concat([nones[nones[by] == group].assign(**{by: name}) for name, group in first.items()])
    table = pd.concat([own, none]).melt(keys, var_name="statistic")
    table = table.pivot(index=["split", by, "statistic"], columns="column", values="value")
    splits = [split for split in ("test", "train") if split in set(tidy["split"])]
    order = [
        (split, group, statistic)
        for split in splits
        for group in (*groups, *first)
        for statistic in (STATISTICS if group in first else (*STATISTICS, RATIO))
    ]
    table = table.reindex(index=pd.MultiIndex.from_tuples(order, names=["split", by, "statistic"])).reindex(
        columns=list(columns)
    )
    table = table.reset_index().rename_axis(columns=None)
    table.insert(0, "source", "clothkit")
    return table


def splits(dataset: Dataset) -> pd.DataFrame:
    """Numbers of sequences and manipulations, and the share of single-handed manipulations, by split."""
    counted = []
    for split in SPLITS:
        chosen = dataset.of_split(split)
        hands = np.concatenate([[], *(own[:length] for own, length in zip(chosen.hands, chosen.length, strict=True))])
        counted.append((split, len(chosen), len(hands), float((hands == 1).mean()) if len(hands) else float("nan")))
    return pd.DataFrame(counted, columns=["split", "sequences", "manipulations", "single_handed"])


def attempts(tidy: pd.DataFrame) -> pd.DataFrame:
    """Outcomes of tried sequences, accepted or the reason for rejection, with counts and shares."""
    outcome = tidy["reason"].where(~tidy["accepted"].astype(bool), "accepted")
    counts = outcome.value_counts().rename_axis("outcome").reset_index(name="attempts")
    counts = counts.sort_values(["attempts", "outcome"], ascending=[False, True], ignore_index=True)
    return counts.assign(share=counts["attempts"] / len(tidy))
