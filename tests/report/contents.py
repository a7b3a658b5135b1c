"""Made-up tidy rows of estimation and prediction, and what a page shows of them."""

import numpy as np
import pandas as pd

from clothkit.dataset.store import Dataset
from clothkit.dataset.tasks import TASKS
from clothkit.evaluation import camera_planning, planning
from clothkit.evaluation.comparisons import of_predictions
from clothkit.report import camera_tables, page, planning_tables, tables
from clothkit.report.rows import VOXEL_SYSTEMS
from tests.evaluation import camera_rows
from tests.evaluation.planning_rows import planning_rows


def tidy_tasks(systems: tuple[str, ...], *, sequences: int = 4, seed: int = 0) -> pd.DataFrame:
    """Rows of prediction; net a is the better one."""
    rng = np.random.default_rng(seed)
    return pd.DataFrame(
        [
            {
                "split": split,
                "system": system,
                "net": net,
                "better": net == "a",
                "sequence": sequence,
                "start": start,
                "length": length,
                "error": rng.uniform(0.01, 0.1) + (net == "b"),
                "error_no_action": 0.2 + 0.01 * sequence + 0.1 * length,
                "sigma_ratio": 0.7 + 0.01 * sequence,
                "position_error": 0.01 * (sequence + length) + (net == "b"),
                "position_no_action": 0.1 * length,
                "voxel_error": rng.uniform(0.01, 0.02) + 0.5 * (net == "b"),
                "voxel_error_no_action": 0.05 + 0.01 * (system in VOXEL_SYSTEMS),
            }
            for split in ("test", "train")
            for system in systems
            for net in ("a", "b")
            for sequence in range(sequences)
            for start, length in TASKS
        ]
    )


def tidy_estimates() -> pd.DataFrame:
    return pd.DataFrame(
        [
            {
                "split": "test",
                "sequence": sequence,
                "state": state,
                "kind": kind,
                "error": 0.01 * state + 0.001 * sequence + (0.1 if kind == "dmr" else 0),
                "error_no_action": 0.25,
                "sigma_ratio": 0.8,
            }
            for sequence in range(3)
            for state in (1, 2, 3)
            for kind in ("pmr", "dmr")
        ]
    )


def dataset() -> Dataset:
    """A sequence of each split, of three manipulations, two and one; the first is single-handed, the others are not."""
    return Dataset(
        np.zeros((3, 4, 32, 32, 3), np.float32),
        np.zeros((3, 4, 2), np.float32),
        np.zeros((3, 3, 6), np.float32),
        np.array([[1, 2, 2]] * 3, np.int8),
        np.array([3, 2, 1], np.int8),
        np.array([0, 1, 2], np.int8),
        np.ones(3, bool),
    )


def contents_of(planners: tuple[str, ...], figures: list[str]) -> page.Contents:
    """What a page shows of made-up rows."""
    tidy, planned = tidy_tasks(("main", "a1")), planning_rows(planners)
    intervals = planning.intervals(planned)
    return page.Contents(
        scale="smoke",
        table_2=tables.estimation(tidy_estimates()),
        table_3=tables.prediction(tidy, ("main", "a1")),
        table_5=tables.position(tidy, ("main", "a1")),
        table_4=tables.prediction_voxels(tidy_tasks(("main", *VOXEL_SYSTEMS)), ("main", *VOXEL_SYSTEMS)),
        comparisons=tables.comparisons(of_predictions(tidy_tasks(VOXEL_SYSTEMS))),
        table_6=planning_tables.planning(planned, intervals, planners),
        table_7=planning_tables.planning_voxels(planned, intervals, planners),
        planning_comparisons=planning_tables.comparisons(planning.comparisons(planned), planners),
        failures=planning_tables.failures(planning.failures(planned), planners),
        camera_estimation=camera_tables.estimation(camera_rows.estimation()),
        camera_planning=camera_tables.planning(camera_rows.planning()),
        camera_comparisons=camera_tables.comparisons(camera_planning.comparisons(camera_rows.planning())),
        largest=planning_tables.largest(planned, planners[0], 3),
        sigma_ratio=tables.sigma_ratio(tidy_estimates(), tidy),
        splits=tables.splits(dataset()),
        attempts=tables.attempts(pd.DataFrame({"accepted": [True], "reason": [""]})),
        tasks={"test": 4, "train": 4},
        canonical="",
        figures=figures,
    )
