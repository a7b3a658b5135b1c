"""Tables for `dvc plots show` and `dvc plots diff` (`plots` in dvc.yaml): small, tidy, of the test split."""

from collections.abc import Mapping

import pandas as pd

from clothkit.report.metrics import LENGTHS
from clothkit.report.tables import TASKS

CALIBRATED = {"estimate": "estimates", "main": "predictions"}


def plots(
    histories: Mapping[str, pd.DataFrame], calibration: pd.DataFrame, table_3: pd.DataFrame, table_6: pd.DataFrame
) -> dict[str, pd.DataFrame]:
    """The tables by name. In a plot of lines, column `line` names the line of a row, and the others are its axes.

    `learning`: validation error [cloth length] over iterations of training, a line per net. `calibration`: the share of
    coordinates whose error is below z sigma (coverage) against that of a normal distribution (expected), a line per
    number of manipulations, and the diagonal. `prediction`, `planning`: mean error [cloth length] over the number of
    manipulations, a line per system. `table_6`: mean error of planning by system and task (length / start).
    """
    return {
        "learning": pd.concat([_learning(net, history) for net, history in histories.items()], ignore_index=True),
        "calibration": _calibration(calibration),
        "prediction": _by_length(_means(table_3)),
        "planning": _by_length(_means(table_6)),
        "table_6": _long(_means(table_6), list(TASKS), "task"),
    }


def _learning(net: str, history: pd.DataFrame) -> pd.DataFrame:
    return history[["iteration", "score"]].rename(columns={"score": "error"}).assign(line=net)


def _calibration(tidy: pd.DataFrame) -> pd.DataFrame:
    rows = tidy[(tidy["split"] == "test") & (tidy["axis"] == "all") & tidy["system"].isin(list(CALIBRATED))]
    lines = []
    for (system, length), line in rows.groupby(["system", "length"], sort=False):
        curve = line.sort_values("z")[["expected", "coverage"]]
        origin = pd.DataFrame({"expected": [0.0], "coverage": [0.0]})
        lines.append(pd.concat([origin, curve]).assign(line=f"{CALIBRATED[str(system)]}, {length}"))
    ideal = pd.DataFrame({"expected": [0.0, 1.0], "coverage": [0.0, 1.0], "line": "ideal"})
    return pd.concat([*lines, ideal], ignore_index=True)


def _means(table: pd.DataFrame) -> pd.DataFrame:
    """Our means, a row per system. "No action" is left out: its large errors would make systems look equal."""
    ours = (table["source"] == "clothkit") & (table["split"] == "test") & (table["statistic"] == "mean")
    return table[ours & ~table["system"].str.startswith("no action")]


def _by_length(means: pd.DataFrame) -> pd.DataFrame:
    named = means.rename(columns={column: length for length, column in LENGTHS.items()})
    return _long(named, list(LENGTHS), "length").rename(columns={"system": "line"})


def _long(means: pd.DataFrame, columns: list[str], name: str) -> pd.DataFrame:
    return means.melt("system", columns, var_name=name, value_name="error").dropna(subset=["error"])
