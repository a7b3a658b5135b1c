"""Made-up tidy rows of named goals: a camera doubles the error, a crumpled start adds 0.1 to it."""

import numpy as np
import pandas as pd

from clothkit.goals.settings import START_NAMES, SYSTEM_OF
from clothkit.manipulation.named_folds import GOALS


def goal_rows(goals: tuple[str, ...] = ("half", "quarter"), repeats: int = 2) -> pd.DataFrame:
    """Rows of planned goals from all starts, and of scripts from flat cloths; SoftGym's measure of half alone."""
    rows = []
    for name in goals:
        for source, factor in (("mesh", 1), ("camera", 2), ("script", 0)):
            for start in START_NAMES if factor else START_NAMES[:1]:
                for repeat in range(repeats):
                    error = 0.02 * factor + 0.1 * (start == "crumpled") + 0.002 * repeat
                    rows.append(
                        {
                            "goal": name,
                            "manipulations": GOALS[name].manipulations,
                            "start": start,
                            "source": source,
                            "system": SYSTEM_OF.get(source),
                            "repeat": repeat,
                            "ratio": 1.0,
                            "thickness": 0.007,
                            "length": GOALS[name].manipulations,
                            "error": error,
                            "error_no_action": 0.3,
                            "softgym": 2 * error if name == "half" else np.nan,
                            "softgym_no_action": 0.5 if name == "half" else np.nan,
                            "iou": 0.9,
                            "iou_no_action": 0.5,
                            "nulls": 0,
                            "expected": 0.03 if factor else np.nan,
                        }
                    )
    return pd.DataFrame(rows)
