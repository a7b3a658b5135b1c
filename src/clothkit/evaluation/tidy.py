"""Declarations of the tidy tables that evaluations write and reports read: columns, ranges, keys, complete rows."""

import dataclasses
import math

import numpy as np
import pandas as pd

from clothkit.dataset.store import SPLITS, STATES, STEPS
from clothkit.dataset.tables import Column, Complete, Rule, Table

VOXEL_SYSTEMS = ("main_occluded", "a2")
"""Systems whose predictions are voxels as a camera sees them, and which have no error in cloth lengths."""

PROBE_KINDS = ("recorded", "displaced", "grasped", "random")
"""Kinds of probes of the forward models: see `probes`."""

_TEXT = Column("text")
_SPLIT = Column("text", among=SPLITS)
_SEQUENCE = Column("whole numbers", 0)
_START = Column("whole numbers", 0, STEPS - 1)
_LENGTH = Column("whole numbers", 1, STEPS)
_STATE = Column("whole numbers", 1, STATES - 1)
_ERROR = Column("numbers", 0, 1e6)
_SHARE = Column("numbers", 0, 1)
_NUMBER = Column("numbers")
_LOSS = Column("numbers", missing=True, optional=True)
_NULLS = Column("whole numbers", 0, STEPS, optional=True)
_TASK = ("sequence", "start", "length")


def _missing(column: Column) -> Column:
    return dataclasses.replace(column, missing=True)


def _optional(column: Column) -> Column:
    return dataclasses.replace(column, optional=True)


_ENDS = Rule(
    ("start", "length"),
    lambda rows: rows["start"] + rows["length"] <= STEPS,
    f"tasks that end at state {STEPS} or before",
)
_INTERVAL = Rule(
    ("low", "high"),
    lambda rows: (rows["low"] <= rows["high"]) | (rows["low"].isna() & rows["high"].isna()),
    "low at or below high, or neither",
)


def _every_task(*by: str) -> Complete:
    """Require all tasks of a sequence: six for three manipulations, three for two, one for one."""

    def rows(tasks: pd.DataFrame) -> pd.Series:
        end = tasks["start"] + tasks["length"]
        return end * (end + 1) // 2

    return Complete((*by, "sequence"), ("start", "length"), rows, "every task of the sequence")


def _every_state(*by: str) -> Complete:
    return Complete((*by, "sequence"), ("state",), lambda rows: rows["state"], "every state from 1 on, none left out")


_VOXEL_ERRORS = {"voxel_error": _SHARE, "voxel_error_no_action": _SHARE}
_VOXEL_ERRORS_025 = {"voxel_error_025": _SHARE, "voxel_error_025_no_action": _SHARE}
_INTERVAL_COLUMNS = {"low": _missing(_NUMBER), "high": _missing(_NUMBER)}

ESTIMATION = Table(
    {
        "split": _SPLIT,
        "sequence": _SEQUENCE,
        "state": _STATE,
        "kind": Column("text", among=("pmr", "dmr")),
        "error": _ERROR,
        "error_labelled": _optional(_ERROR),
        "error_no_action": _ERROR,
        "sigma_ratio": _ERROR,
        # Older rows tell nothing of hypotheses.
        "hypotheses": Column("whole numbers", 1, optional=True),
        "probability": _optional(_SHARE),
        "error_best": _optional(_ERROR),
    },
    keys=("split", "sequence", "state", "kind"),
    complete=(_every_state("split", "kind"),),
)

PREDICTION = Table(
    {
        "split": _SPLIT,
        "system": _TEXT,
        "net": _TEXT,
        "better": Column("true or false"),
        "sequence": _SEQUENCE,
        "start": _START,
        "length": _LENGTH,
        "error": _missing(_ERROR),
        "error_no_action": _ERROR,
        "sigma_ratio": _missing(_ERROR),
        "position_error": _ERROR,
        "position_no_action": _ERROR,
        **_VOXEL_ERRORS,
        **{name: _optional(column) for name, column in _VOXEL_ERRORS_025.items()},
    },
    keys=("split", "system", "net", *_TASK),
    rules=(
        _ENDS,
        *(
            Rule(
                ("system", name),
                lambda rows: rows.iloc[:, 1].notna() | rows["system"].isin(VOXEL_SYSTEMS),
                f"{name} to be a number for all systems but {' and '.join(VOXEL_SYSTEMS)}",
            )
            for name in ("error", "sigma_ratio")
        ),
    ),
    complete=(_every_task("split", "system", "net"),),
)

CALIBRATION = Table(
    {
        "split": _SPLIT,
        "system": _TEXT,
        "length": _LENGTH,
        "axis": Column("text", among=("all", "xy", "z")),
        "z": _ERROR,
        "expected": _SHARE,
        "coverage": _SHARE,
    },
    keys=("split", "system", "length", "axis", "z"),
    rules=(
        Rule(
            ("z", "expected"),
            lambda rows: np.isclose(rows["expected"], [math.erf(z / math.sqrt(2)) for z in rows["z"]], atol=1e-6),
            "expected to be a normal distribution's share within z",
        ),
    ),
)

PLANNING = Table(
    {
        "split": _SPLIT,
        "system": _TEXT,
        "sequence": _SEQUENCE,
        "start": _START,
        "length": _LENGTH,
        "error": _ERROR,
        "error_labelled": _ERROR,
        "error_no_action": _ERROR,
        **_VOXEL_ERRORS,
        "layers_reversed": _missing(_SHARE),
        **dict.fromkeys(("nulls", "nulls_fired", "nulls_last", "nulls_helped"), _NULLS),
        "loss": _missing(_NUMBER),
        "loss_recorded": _missing(_NUMBER),
        "uncertainty": _LOSS,
        "expected": _missing(_ERROR),
        "grasp_offered": Column("true or false"),
        "estimate_error": _missing(_ERROR),
        "estimate_layers_reversed": _missing(_SHARE),
    },
    keys=("split", "system", *_TASK),
    rules=(_ENDS,),
    complete=(_every_task("split", "system"),),
    # A term of each of the system's nets. In rows of several systems those with fewer nets have none.
    numbered={"accuracy": _LOSS},
)

VOXELS_025 = Table(
    {
        "split": _SPLIT,
        "system": _TEXT,
        "sequence": _SEQUENCE,
        "start": _START,
        "length": _LENGTH,
        **_VOXEL_ERRORS_025,
    },
    keys=PLANNING.keys,
    rules=(_ENDS,),
    complete=PLANNING.complete,
)
"""Voxel errors in the viewport of height 0.25, for the same rows as PLANNING."""

COMPARISONS = Table(
    {
        # For cameras, the condition is in the column `system`, and all rows are of one split.
        "split": _SPLIT,
        "measure": _TEXT,
        "system": _TEXT,
        "against": _TEXT,
        "column": _TEXT,
        "sequences": Column("whole numbers", 1),
        "difference": _NUMBER,
        **_INTERVAL_COLUMNS,
        "p": _missing(_SHARE),
    },
    keys=("split", "measure", "system", "against", "column"),
    rules=(_INTERVAL,),
)

ANY_COMPARISONS = dataclasses.replace(COMPARISONS, may_be_empty=True)
"""COMPARISONS that may have no rows, if there was only one system to compare."""

INTERVALS = Table(
    {
        "split": _SPLIT,
        "system": _TEXT,
        "measure": _TEXT,
        "column": _TEXT,
        "sequences": Column("whole numbers", 1),
        "mean": _ERROR,
        **_INTERVAL_COLUMNS,
    },
    keys=("split", "system", "measure", "column"),
    rules=(_INTERVAL,),
)

FAILURES = Table(
    {
        "split": _SPLIT,
        "system": _TEXT,
        "length": Column("text", among=("1", "2", "3", "all")),
        "tasks": Column("whole numbers", 1),
        **dict.fromkeys(("search_failure", "model_failure", "nulls_helped", "layers_reversed"), _missing(_SHARE)),
        "grasp_offered": _SHARE,
        "nulls_fired": Column("numbers", 0, STEPS),
        "error": _ERROR,
        **dict.fromkeys(("expected", "error_estimate_good", "error_estimate_bad"), _missing(_ERROR)),
    },
    keys=("split", "system", "length"),
)

CAMERA_ESTIMATION = Table(
    {
        "condition": _TEXT,
        "tilt": Column("numbers", 0, math.pi / 2),
        "noise": _ERROR,
        "sequence": _SEQUENCE,
        "state": _STATE,
        "seen": Column("true or false"),
        **dict.fromkeys(("voxel_error", "iou"), _missing(_SHARE)),
        **dict.fromkeys(("centre_error", "error"), _missing(_ERROR)),
        "alarm": Column("true or false"),
    },
    keys=("condition", "sequence", "state"),
    rules=tuple(
        Rule(
            ("seen", name),
            lambda rows: rows.iloc[:, 1].notna() == rows["seen"],
            f"{name} to be a number where the cloth was seen, and nothing where it was not",
        )
        for name in ("voxel_error", "centre_error", "iou", "error")
    ),
    complete=(_every_state("condition"),),
)

CAMERA_PLANNING = Table(
    {
        **PLANNING.columns,
        "condition": _TEXT,
        "tilt": Column("numbers", 0, math.pi / 2),
        "noise": _ERROR,
        **dict.fromkeys(("iou", "iou_no_action"), _SHARE),
        "iou_seen": _missing(_SHARE),
    },
    keys=("condition", *PLANNING.keys),
    rules=(_ENDS,),
    complete=(_every_task("condition", "split", "system"),),
    numbered=PLANNING.numbered,
)

PROBES = Table(
    {
        "sequence": _SEQUENCE,
        "start": _START,
        "kind": Column("text", among=PROBE_KINDS),
        "step": _STATE,
        **dict.fromkeys(("error", "distance", "sigma"), _ERROR),
        **dict.fromkeys(("difference", "surprise"), Column("numbers", 0)),
        **dict.fromkeys(("deviations", "conditional"), _missing(_NUMBER)),
        "expected": _missing(_ERROR),
    },
    numbered={"error": _ERROR},
)

TRUST = Table(
    {
        "sequence": _SEQUENCE,
        "start": _START,
        "length": _LENGTH,
        **dict.fromkeys(("expected", "sigma", "error", "error_no_action"), _ERROR),
        "model_error": _missing(_ERROR),
        **dict.fromkeys(("trusted_error", "trusted_low", "trusted_high"), _missing(_ERROR)),
        "trusted_trust": _missing(_SHARE),
    },
    keys=_TASK,
    rules=(_ENDS,),
)

HISTORY = Table(
    {"iteration": Column("whole numbers", 0), "score": _ERROR},
    keys=("iteration",),
    rules=(Rule(("iteration",), lambda rows: rows["iteration"].diff().fillna(1) > 0, "more than in the row before"),),
)
"""A net's training history, a row per validation; further columns with the errors of single tasks may follow."""
