"""Made-up tables of the studies that pages show: what agents choose, what is cut, and what is within reach."""

import math
from itertools import product

import pandas as pd

from clothkit.report.layout import BY_LENGTH


def study_tables() -> dict[str, pd.DataFrame]:
    """The tables by name, with columns as the studies write them and numbers that tell rows apart."""
    return {
        "plan_length_summary": plan_length(),
        "plan_length_margins": margins(),
        "plan_length_ways_summary": plan_ways(),
        "reach_summary": reach(),
    }


def plan_length() -> pd.DataFrame:
    """Choosing takes 0.25 manipulations more, and 0.01 from the error of goals of three."""
    rows = []
    for split, steps, column in product(("validation", "test"), ("given", "1", "chosen"), ("1/0", *BY_LENGTH, "all")):
        length, chosen = 2.0 if column == "all" else float(column[0]), steps == "chosen"
        gain = 0.01 * (chosen and length == 3)
        error = 0.02 * length - gain + 0.5 * (split == "validation")
        paired = chosen and column != "all"
        rows.append(
            {
                "split": split,
                "system": "main",
                "steps": steps,
                "column": column,
                "tasks": 60,
                "error": error,
                "error_low": error - 0.005,
                "error_high": error + 0.005,
                "used": length + 0.25 * chosen,
                "as_recorded": 0.5,
                "error_no_action": 0.3,
                "difference": -gain if paired else math.nan,
                "difference_low": -gain - 0.002 if paired else math.nan,
                "difference_high": -gain + 0.002 if paired else math.nan,
                "p": 0.03 if paired else math.nan,
            }
        )
    return pd.DataFrame(rows)


def margins() -> pd.DataFrame:
    return pd.DataFrame(
        {
            "margin": [0.0, 0.015, 0.1],
            "tasks": 120,
            "error": [0.0421, 0.0407, 0.0531],
            "used": [1.56, 1.44, 1.14],
            "difference": [0.0014, 0.0, 0.0124],
            "standard_error": [0.0013, 0.0, 0.0024],
            "chosen": [0, 1, 0],
        }
    )


def plan_ways() -> pd.DataFrame:
    rows = [
        ("validation", measure, column, 12, 0.031, 0.042, 0.011, 0.006, 0.016, 0.001)
        for measure, column in product(("expected", "error"), ("1/0", *BY_LENGTH))
    ]
    names = ["split", "measure", "column", "sequences", "own", "cut", "difference", "low", "high", "p"]
    return pd.DataFrame(rows, columns=names)


def reach() -> pd.DataFrame:
    """Half as many plans stay inside by turning alone, and fewer the smaller the region is."""
    rows = []
    for (region, sizes), way in product({"square": (0.3, 0.15), "side": (0.21, 0.0)}.items(), ("turning", "terms")):
        for place, size in enumerate(sizes):
            inside = (1.0, 0.5)[place] * (0.5 if way == "turning" else 1.0)
            row: dict[str, object] = {"region": region, "size": size, "way": way, "tasks": 180}
            row |= {"inside": inside, "inside_low": inside - 0.1, "inside_high": inside, "turned": 0.2 * inside}
            row |= {"searched": 0.0 if way == "turning" else 0.3 * inside}
            error = 0.3 - 0.2 * inside
            row |= {"error": error, "error_low": error - 0.01, "error_high": error + 0.01, "error_inside": 0.05}
            rows.append({**row, "error_free_inside": 0.04, "error_free": 0.045, "error_no_action": 0.3})
    return pd.DataFrame(rows)
