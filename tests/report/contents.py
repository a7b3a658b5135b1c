"""Made-up tidy rows of estimation and prediction, and what a page shows of them."""

import functools
import shutil
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from clothkit.dataset.store import Dataset, papers_cloths
from clothkit.dataset.tasks import TASKS
from clothkit.evaluation import camera_planning, doubt, planning
from clothkit.evaluation.comparisons import of_predictions
from clothkit.report import camera_tables, contents, doubt_tables, goal_tables, pages, planning_tables, tables, timings
from clothkit.report.blocks import Section
from clothkit.report.budgets import budgets
from clothkit.report.rows import VOXEL_SYSTEMS
from clothkit.report.sections import TABLES, sections
from tests.evaluation import camera_rows
from tests.evaluation.doubt_rows import probe_rows, trust_rows
from tests.evaluation.planning_rows import planning_rows
from tests.goals.goal_rows import goal_rows
from tests.report.study_tables import study_tables

GOAL_MEASURES = {"goals": "error", "goals_softgym": "softgym", "goals_iou": "iou"}
LAPTOP = Path(__file__).parents[2] / "reports/laptop"


def tidy_tasks(systems: tuple[str, ...], *, sequences: int = 4, seed: int = 0) -> pd.DataFrame:
    """Rows of prediction; net a is the better one."""
    rng = np.random.default_rng(seed)
    return pd.DataFrame(
        [
            {
                "split": split,
                "system": system,
                "net": net,
                "better": net == "0",
                "sequence": sequence,
                "start": start,
                "length": length,
                "error": rng.uniform(0.01, 0.1) + (net == "1"),
                "error_no_action": 0.2 + 0.01 * sequence + 0.1 * length,
                "sigma_ratio": 0.7 + 0.01 * sequence,
                "position_error": 0.01 * (sequence + length) + (net == "1"),
                "position_no_action": 0.1 * length,
                "voxel_error": rng.uniform(0.01, 0.02) + 0.5 * (net == "1"),
                "voxel_error_no_action": 0.05 + 0.01 * (system in VOXEL_SYSTEMS),
                "voxel_error_025": rng.uniform(0.005, 0.01) + 0.5 * (net == "1"),
                "voxel_error_025_no_action": 0.025,
            }
            for split in ("test", "train")
            for system in systems
            for net in ("0", "1")
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
        *papers_cloths(3),
    )


def tables_of(planners: tuple[str, ...], *, sequences: int = 12) -> dict[str, pd.DataFrame]:
    """The tables of made-up rows, those of costs included."""
    return dict(_tables_of(planners, sequences))


@functools.cache
def _tables_of(planners: tuple[str, ...], sequences: int) -> dict[str, pd.DataFrame]:
    predictors = ("main", "a1", *VOXEL_SYSTEMS)
    tidy, planned = tidy_tasks(predictors), planning_rows(planners, sequences=sequences)
    intervals = planning.intervals(planned)
    costs = pd.DataFrame([["plan@main", 9.0, 18.0, 900, "8 x z80 CP/M"]], columns=timings.COLUMNS)
    return {
        "table_2": tables.estimation(tidy_estimates()),
        "table_3": tables.prediction(tidy, ("main", "a1")),
        "table_4": tables.prediction_voxels(tidy, predictors),
        "table_4_025": tables.prediction_voxels(tidy, predictors, measure="voxel_error_025"),
        "comparisons": tables.comparisons(of_predictions(tidy_tasks(VOXEL_SYSTEMS, sequences=sequences))),
        "table_5": tables.position(tidy, ("main", "a1")),
        "table_6": planning_tables.planning(planned, intervals, planners),
        "table_7": planning_tables.planning_voxels(planned, intervals, planners),
        "table_7_025": planning_tables.planning_voxels(planned, intervals, planners, measure="voxel_error_025"),
        "planned": planning_tables.planned(planned),
        "planning_comparisons": planning_tables.comparisons(planning.comparisons(planned), planners),
        "failures": planning_tables.failures(planning.failures(planned), planners),
        "largest": planning_tables.largest(planned, planners[0], 3),
        "camera_estimation": camera_tables.estimation(camera_rows.estimation()),
        "camera_planning": camera_tables.planning(camera_rows.planning()),
        "camera_comparisons": camera_tables.comparisons(camera_planning.comparisons(camera_rows.planning())),
        "doubt": doubt_tables.doubt(doubt.summary(probe_rows())),
        "trust": doubt_tables.trust(trust_rows()),
        **{name: goal_tables.goals(goal_rows(), measure) for name, measure in GOAL_MEASURES.items()},
        "sigma_ratio": tables.sigma_ratio(tidy_estimates(), tidy),
        "splits": tables.splits(dataset()),
        "attempts": tables.attempts(pd.DataFrame({"accepted": [True], "reason": [""]})),
        "table_8": timings.table_8(Path("none"), planners),
        "timings": costs,
        **study_tables(),
    }


def write_report(
    folder: Path, made: dict[str, pd.DataFrame], figures: Sequence[str] = (), studies: Sequence[str] = ()
) -> Path:
    """A report's folder of such tables, as the report stage leaves it: settings are laptop's, pictures are small.

    `studies` are paths of the studies' pictures.
    """
    for name in ("tables", "figures", "studies"):
        (folder / name).mkdir(parents=True)
    places = {Path(path).stem: path for path in TABLES}
    for name, table in made.items():
        path = folder / places.get(name, f"tables/{name}.csv")
        table.to_csv(path, index=False, float_format="%.5g", lineterminator="\n")
    for picture_path in (*(f"figures/{name}.png" for name in figures), *studies):
        picture = np.full((300, 1700, 3), 255, np.uint8)
        cv2.circle(picture, (850, 150), 120, (190, 120, 60), -1)
        cv2.imwrite(str(folder / picture_path), picture)
    shutil.copy(LAPTOP / "params.yaml", folder)
    return folder


def contents_of(
    folder: Path, planners: tuple[str, ...], figures: Sequence[str] = (), studies: Sequence[str] = ()
) -> contents.Contents:
    """What pages show of made-up rows."""
    return pages.read(write_report(folder, tables_of(planners), figures, studies))


def parts_of(shown: contents.Contents) -> list[Section]:
    """The sections of its pages."""
    own = shown.tables["table_6"].query("source == 'clothkit'")["system"].drop_duplicates()
    return sections(shown, budgets(shown.settings, shown.tables.get("timings"), [s for s in own if s != "no action"]))
