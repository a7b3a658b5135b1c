"""Made-up tidy rows of planning, as the plan stages write them."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from clothkit.dataset.tasks import TASKS

SYSTEMS = ("main", "b1", "b2", "b3", "b4", "b5")
VOXEL_SYSTEMS = ("b4", "b5")


def planning_rows(
    systems: Sequence[str] = SYSTEMS,
    *,
    sequences: int = 4,
    splits: Sequence[str] = ("test", "train"),
    seed: int = 0,
) -> pd.DataFrame:
    """Rows of every task; voxel systems have no estimate and expect nothing in cloth lengths."""
    rng = np.random.default_rng(seed)
    tidy = pd.DataFrame(
        [
            {"split": split, "system": system, "sequence": sequence, "start": start, "length": length}
            for split in splits
            for system in systems
            for sequence in range(sequences)
            for start, length in TASKS
        ]
    )
    count = len(tidy)
    fired = rng.integers(0, 2, count)
    layers = np.random.default_rng(seed + 1)
    voxels = tidy["system"].isin(VOXEL_SYSTEMS)
    return tidy.assign(
        error=rng.uniform(0.01, 0.1, count),
        error_no_action=0.2 + 0.01 * tidy["sequence"] + 0.1 * tidy["length"],
        voxel_error=rng.uniform(0.001, 0.02, count),
        voxel_error_no_action=0.03 + 0.01 * tidy["length"],
        nulls=fired,
        nulls_fired=fired,
        nulls_helped=fired * rng.integers(0, 2, count),
        loss=rng.uniform(0, 1, count),
        loss_recorded=rng.uniform(0, 1, count),
        expected=np.where(voxels, np.nan, rng.uniform(0.01, 0.08, count)),
        grasp_offered=rng.uniform(size=count) < 0.8,
        estimate_error=np.where(voxels, np.nan, rng.uniform(0.01, 0.08, count)),
        error_labelled=layers.uniform(0.1, 0.2, count),
        layers_reversed=layers.uniform(0, 0.5, count),
        estimate_layers_reversed=np.where(voxels, np.nan, layers.uniform(0, 0.5, count)),
        nulls_last=fired,
        voxel_error_025=layers.uniform(0.001, 0.02, count),
        voxel_error_025_no_action=0.02 + 0.01 * tidy["length"],
    )
