"""What the evaluation of named goals leaves: the schemas of its rows and of its arrays."""

from clothkit.dataset.store import NORMALISED
from clothkit.dataset.tables import Column, Rule, Table
from clothkit.dataset.zarr_store import Declared
from clothkit.goals.settings import SOURCE_NAMES, START_NAMES
from clothkit.manipulation.named_folds import GOALS

_LENGTH = Column("numbers", 0)
_MAYBE = Column("numbers", 0, missing=True)
_SHARE = Column("numbers", 0, 1)

TABLE = Table(
    {
        "goal": Column("text", among=tuple(GOALS)),
        "manipulations": Column("whole numbers", 1),
        "start": Column("text", among=START_NAMES),
        "source": Column("text", among=SOURCE_NAMES),
        "system": Column("text", missing=True),
        "repeat": Column("whole numbers", 0),
        "ratio": Column("numbers", 1),
        "thickness": Column("numbers", 0),
        "length": Column("whole numbers", 1),
        "error": _LENGTH,
        "error_no_action": _LENGTH,
        "softgym": _MAYBE,
        "softgym_no_action": _MAYBE,
        "iou": _SHARE,
        "iou_no_action": _SHARE,
        "nulls": Column("whole numbers", 0),
        "expected": _MAYBE,
    },
    keys=("goal", "start", "source", "repeat"),
    rules=(
        Rule(("length", "nulls"), lambda rows: rows["nulls"] <= rows["length"], "at most as many nulls as its length"),
    ),
)
"""The schema of data/evaluation/goals.parquet."""

PICTURED = {
    "goal": Declared("i8", ("example",)),
    "begins": Declared("i8", ("example",)),
    "source": Declared("i8", ("example",)),
    "target": Declared("f4", ("example", "u", "v", "xyz"), NORMALISED),
    "start": Declared("f4", ("example", "u", "v", "xyz"), NORMALISED),
    "outcome": Declared("f4", ("example", "u", "v", "xyz"), NORMALISED),
}
"""The arrays of data/evaluation/goals.zarr: an example for each goal, start and source of the first repeat.

`goal`, `begins` and `source` are places in GOALS, START_NAMES and SOURCE_NAMES.
"""
