"""Everything that the report is made from, read and checked at once."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from clothkit.dataset import store
from clothkit.dataset.store import Dataset
from clothkit.evaluation import arrays, tidy
from clothkit.planning import record
from clothkit.planning.record import Sessions
from clothkit.report import rows
from clothkit.report.settings import ReportConfig

NETS = ("a", "b")

PICTURES = ("sequence", "shown", "height", "voxels", "mesh")


@dataclass(frozen=True)
class Inputs:
    """Tidy rows and the arrays of the pictures."""

    dataset: Dataset
    attempts: pd.DataFrame
    histories: Mapping[str, pd.DataFrame]
    """Of the nets a, b and vtm."""
    estimation: pd.DataFrame
    prediction: pd.DataFrame
    calibration: pd.DataFrame
    comparisons: pd.DataFrame
    planning: pd.DataFrame
    """Of all planners."""
    planning_comparisons: pd.DataFrame
    intervals: pd.DataFrame
    """Of mean errors of planning."""
    failures: pd.DataFrame
    camera_estimation: pd.DataFrame
    camera_planning: pd.DataFrame
    camera_comparisons: pd.DataFrame
    estimates: Mapping[str, np.ndarray]
    predictions: Mapping[str, np.ndarray]
    sessions: Sessions
    """Of the first planner."""
    pictures: Mapping[str, np.ndarray]
    """What depth cameras show."""


def paths(data: Path, settings: ReportConfig) -> list[Path]:
    """The artifacts under `data` that `read` opens."""
    evaluation = data / "evaluation"
    return [
        data / "meshes.zarr",
        data / "raw/attempts.parquet",
        *(data / f"nets/pemd_{net}/history.parquet" for net in NETS),
        data / "nets/vtm/history.parquet",
        evaluation / "estimation.parquet",
        evaluation / "estimates.zarr",
        evaluation / "prediction.parquet",
        evaluation / "calibration.parquet",
        evaluation / "comparisons.parquet",
        evaluation / "predictions.zarr",
        *(evaluation / f"planning/{system}.parquet" for system in settings.planners),
        *(evaluation / f"planning/{name}.parquet" for name in ("comparisons", "intervals", "failures", "voxels_025")),
        evaluation / f"planning/sessions_{settings.planners[0]}.zarr",
        *(evaluation / f"camera/{name}.parquet" for name in ("estimation", "planning", "comparisons")),
        evaluation / "camera/pictures.zarr",
    ]


def read(data: Path, settings: ReportConfig) -> Inputs:
    """The report's inputs from the artifacts under `data`. Raises InputError for what is missing or malformed."""
    evaluation = data / "evaluation"
    forward = {net: rows.read(data / f"nets/pemd_{net}/history.parquet", rows.HISTORY) for net in NETS}
    return Inputs(
        dataset=store.load(data / "meshes.zarr"),
        attempts=rows.read(data / "raw/attempts.parquet", rows.ATTEMPTS),
        histories={**forward, "vtm": rows.read(data / "nets/vtm/history.parquet", rows.HISTORY)},
        estimation=rows.read(evaluation / "estimation.parquet", rows.ESTIMATION),
        prediction=rows.read(evaluation / "prediction.parquet", rows.PREDICTION),
        calibration=rows.read(evaluation / "calibration.parquet", rows.CALIBRATION),
        comparisons=rows.read(evaluation / "comparisons.parquet", rows.COMPARISONS),
        planning=rows.read_planning(evaluation / "planning", settings.planners),
        planning_comparisons=rows.read_comparisons(evaluation / "planning/comparisons.parquet"),
        intervals=rows.read(evaluation / "planning/intervals.parquet", rows.INTERVALS),
        failures=rows.read(evaluation / "planning/failures.parquet", rows.FAILURES),
        estimates=arrays.load(evaluation / "estimates.zarr", ("sequence", "mean", "std", "mesh", "label")),
        predictions=arrays.load(evaluation / "predictions.zarr", ("sequence", "start", "mean", "std", "shift")),
        sessions=record.load(evaluation / f"planning/sessions_{settings.planners[0]}.zarr"),
        camera_estimation=tidy.read(evaluation / "camera/estimation.parquet", rows.CAMERA_ESTIMATION),
        camera_planning=rows.read(evaluation / "camera/planning.parquet", rows.CAMERA_PLANNING),
        camera_comparisons=rows.read_comparisons(evaluation / "camera/comparisons.parquet"),
        pictures=arrays.load(evaluation / "camera/pictures.zarr", PICTURES),
    )
