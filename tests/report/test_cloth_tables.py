"""Errors by cloth, against means worked by hand."""

import dataclasses

import numpy as np
import pandas as pd

from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.dataset.store import Dataset
from clothkit.report.cloth_tables import by_cloth, classes
from clothkit.report.layout import BY_CLOTH
from clothkit.simulation.settings import STARTS
from tests.toy_dataset import dataset

MM = CLOTH_LENGTH / 400
"""A millimetre of a cloth with a side of 0.4 m [normalised]."""


def various() -> Dataset:
    cloth = np.array([[1.4, 1.4, 2 * MM], [1.4, 1.0, 5 * MM], [0.8, 1.4, 8 * MM], [1.4, 1.4, 8 * MM]], np.float32)
    start = np.array([STARTS.index(name) for name in ("flat", "dropped", "flat", "flat")], np.int8)
    return dataclasses.replace(dataset(4), cloth=cloth, start=start)


def estimates(errors: list[float]) -> pd.DataFrame:
    rows = pd.DataFrame({"sequence": range(4), "state": 1, "split": "test", "kind": "dmr", "error": errors})
    others = [{"state": 0}, {"kind": "pmr"}, {"split": "train"}]
    return pd.concat([rows, *(rows.assign(error=9.0, **other) for other in others)], ignore_index=True)


def plans(errors: list[float]) -> pd.DataFrame:
    return pd.DataFrame({"sequence": range(4), "length": 3, "split": "test", "system": "main", "error": errors})


def test_classes_of_cloths() -> None:
    found = classes(various())
    assert found["thickness"].tolist() == ["up to 0.8 %", "0.8 to 1.4 %", "above 1.4 %", "above 1.4 %"]
    assert found["ratio"].tolist() == ["square", "up to 1.4", "above 1.4", "square"]
    assert found["start"].tolist() == ["flat", "dropped", "flat", "flat"]


def test_means_by_class() -> None:
    table = by_cloth(various(), estimates([0.1, 0.2, 0.3, 0.5]), plans([0.2, 0.2, 0.3, 0.4]))
    assert list(table.columns) == list(BY_CLOTH)
    rows = table.set_index(["measure", "property", "class"])
    assert len(rows) == 2 * (3 + 3 + 2)
    np.testing.assert_allclose(rows.loc[("estimate", "thickness", "above 1.4 %"), "1"], 0.4)
    np.testing.assert_allclose(rows.loc[("estimate", "ratio", "square"), "1"], 0.3)
    np.testing.assert_allclose(rows.loc[("plan", "start", "flat"), "3"], 0.3)
    assert rows.loc[("plan", "start", "flat"), "sequences"] == 3
    assert np.isnan(rows.loc[("plan", "start", "flat"), "1"])
    of_thickness = table[table["property"] == "thickness"]["class"]
    assert of_thickness.tolist() == ["up to 0.8 %", "0.8 to 1.4 %", "above 1.4 %"] * 2


def test_cloths_that_are_alike_have_no_table() -> None:
    assert by_cloth(dataset(4), estimates([0.1] * 4), plans([0.1] * 4)).empty
