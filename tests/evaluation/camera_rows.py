"""Made-up tidy rows of what depth cameras cost: twice the noise, twice the error."""

import numpy as np
import pandas as pd

from tests.evaluation.planning_rows import planning_rows

CONDITIONS = (("voxels", 0.0, 0.0), ("tilted", 0.35, 0.0), ("noise", 0.35, 1.0))


def estimation() -> pd.DataFrame:
    """Two states by three conditions; under the last one is not seen."""
    rows = []
    for place, (condition, tilt, noise) in enumerate(CONDITIONS):
        for state in (1, 2):
            seen = not (noise and state == 2)
            measured = {"voxel_error": 0.01 * place, "centre_error": 0.0, "iou": 0.9, "error": 0.02 * state}
            told = {name: value if seen else np.nan for name, value in measured.items()}
            row = {"condition": condition, "tilt": tilt, "noise": noise, "sequence": 0, "state": state, "seen": seen}
            rows.append({**row, **told, "alarm": seen and place == 1})
    return pd.DataFrame(rows)


def planning() -> pd.DataFrame:
    """The tasks of three sequences; each condition is 0.01 worse than the one before."""
    tidy = planning_rows(("main",), sequences=3, splits=("test",))
    found = []
    for place, (condition, tilt, noise) in enumerate(CONDITIONS):
        named = tidy.assign(condition=condition, tilt=tilt, noise=noise, error=tidy["error"] + 0.01 * place)
        found.append(named.assign(iou=0.8, iou_no_action=0.6, iou_seen=0.7 if tilt else np.nan))
    return pd.concat(found, ignore_index=True)
