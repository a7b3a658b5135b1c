"""Errors by cloth: group-bys of tidy rows by thickness, by ratio of the sides, and by how sequences began."""

import numpy as np
import pandas as pd

from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.dataset.store import Dataset
from clothkit.report.layout import BY_CLOTH, LENGTHS
from clothkit.simulation.settings import STARTS

CLASSES: dict[str, dict[str, float]] = {
    "thickness": {"up to 0.8 %": 0.8, "0.8 to 1.4 %": 1.4, "above 1.4 %": np.inf},
    "ratio": {"square": 1.001, "up to 1.4": 1.4, "above 1.4": np.inf},
}
"""Classes in order, each with its upper limit: of the thickness in percent of the longer side (0.8 is 3.2 mm of 0.4 m),
and of the longer side over the shorter one."""


def classes(dataset: Dataset) -> pd.DataFrame:
    """The classes of each sequence's cloth as text, a column per property: thickness, ratio, start."""
    sides, thickness = dataset.cloth[:, :2], dataset.cloth[:, 2]
    values = {"thickness": 100 * thickness / CLOTH_LENGTH, "ratio": sides.max(1) / sides.min(1)}
    found = {}
    for name, limits in CLASSES.items():
        place = np.searchsorted(list(limits.values()), values[name])
        found[name] = pd.Categorical.from_codes(place, pd.Index(list(limits)))
    return pd.DataFrame({**found, "start": pd.Categorical.from_codes(dataset.start, pd.Index(STARTS))})


def by_cloth(dataset: Dataset, estimation: pd.DataFrame, planning: pd.DataFrame) -> pd.DataFrame:
    """Mean errors on the test set [cloth length] by class of the cloth; empty if all cloths are of one class.

    Columns: measure (estimate, plan), system (of plans), property (thickness, ratio, start), class, sequences (number)
    and 1, 2, 3: for estimates the number of the state, for plans their length.
    """
    cloths = classes(dataset)
    states = estimation[(estimation["split"] == "test") & (estimation["kind"] == "dmr") & (estimation["state"] > 0)]
    parts = [("estimate", "", states.rename(columns={"state": "column"}))]
    plans = planning[planning["split"] == "test"].rename(columns={"length": "column"})
    parts += [("plan", str(system), rows) for system, rows in plans.groupby("system", sort=False)]
    found = []
    for name in cloths.columns[cloths.nunique() > 1]:
        for measure, system, rows in parts:
            of_class = cloths[name].iloc[rows["sequence"]].to_numpy()
            for each in cloths[name].cat.categories.intersection(pd.Index(of_class), sort=False):
                own = rows[of_class == each]
                means = own.groupby(own["column"].astype(str))["error"].mean().reindex(list(LENGTHS))
                found.append((measure, system, name, each, own["sequence"].nunique(), *means))
    return pd.DataFrame(found, columns=list(BY_CLOTH))
