"""Reads and checks all artifacts that the report is made from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from clothkit.cloth.voxels import Viewport
from clothkit.dataset import store, tables
from clothkit.dataset.raw import ATTEMPTS
from clothkit.dataset.store import Dataset
from clothkit.episodes import record
from clothkit.episodes.record import Sessions
from clothkit.evaluation import arrays, doubt, tidy
from clothkit.goals import tidy as goals_tidy
from clothkit.models.ensemble import folders
from clothkit.models.store import ATTRIBUTES, HISTORY, configuration
from clothkit.report import rows
from clothkit.report.settings import ReportConfig


@dataclass(frozen=True)
class Inputs:
    """Tidy rows, and the arrays for the pictures."""

    dataset: Dataset
    attempts: pd.DataFrame
    forward_histories: Mapping[str, pd.DataFrame]
    """Histories of training of the ensemble's forward models, by member."""
    vtm_history: pd.DataFrame
    viewport: Viewport
    """That of the voxels from which VtM estimates."""
    estimation: pd.DataFrame
    prediction: pd.DataFrame
    calibration: pd.DataFrame
    comparisons: pd.DataFrame
    planning: pd.DataFrame
    """Rows of all planners."""
    planning_comparisons: pd.DataFrame
    intervals: pd.DataFrame
    """Bootstrap intervals of the planners' mean errors."""
    failures: pd.DataFrame
    camera_estimation: pd.DataFrame
    camera_planning: pd.DataFrame
    camera_comparisons: pd.DataFrame
    estimates: Mapping[str, np.ndarray]
    predictions: Mapping[str, np.ndarray]
    sessions: Sessions
    """Sessions of the first planner."""
    pictures: Mapping[str, np.ndarray]
    """Depth cameras' pictures of examples, with voxels and estimates from them."""
    probes: pd.DataFrame
    """Manipulations that were executed to learn where the nets are wrong."""
    doubt: pd.DataFrame
    """How well measures of uncertainty tell their errors (`doubt.summary`)."""
    trust: pd.DataFrame
    """Validation plans that were executed, and what was expected of them."""
    goals: pd.DataFrame | None = None
    """Plans for named goals; None: there are none at this scale."""
    goal_pictures: Mapping[str, np.ndarray] | None = None
    """Examples of them as meshes."""


def paths(data: Path, members: Sequence[int], settings: ReportConfig) -> list[Path]:
    """The artifacts under `data` that `read` opens."""
    evaluation = data / "evaluation"
    return [
        data / "meshes.zarr",
        data / "raw/attempts.parquet",
        *(folder / HISTORY for folder in folders(data / "nets", "pemd", members).values()),
        *(data / "nets/vtm" / name for name in (HISTORY, ATTRIBUTES)),
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
        evaluation / "probe.parquet",
        evaluation / "trust.parquet",
        *(evaluation / name for name in ("goals.parquet", "goals.zarr") if settings.goals),
    ]


def read(data: Path, members: Sequence[int], settings: ReportConfig) -> Inputs:
    """The report's inputs from the artifacts under `data`. Raises InputError for what is missing or malformed."""
    evaluation = data / "evaluation"
    forward = folders(data / "nets", "pemd", members)
    probes = tables.read(evaluation / "probe.parquet", tidy.PROBES)
    return Inputs(
        dataset=store.load(data / "meshes.zarr"),
        attempts=tables.read(data / "raw/attempts.parquet", ATTEMPTS),
        forward_histories={str(m): tables.read(folder / HISTORY, tidy.HISTORY) for m, folder in forward.items()},
        vtm_history=tables.read(data / "nets/vtm" / HISTORY, tidy.HISTORY),
        viewport=configuration(data / "nets/vtm", "vtm").viewport,
        estimation=tables.read(evaluation / "estimation.parquet", tidy.ESTIMATION),
        prediction=tables.read(evaluation / "prediction.parquet", tidy.PREDICTION),
        calibration=tables.read(evaluation / "calibration.parquet", tidy.CALIBRATION),
        comparisons=tables.read(evaluation / "comparisons.parquet", tidy.ANY_COMPARISONS),
        planning=rows.read_planning(evaluation / "planning", settings.planners),
        planning_comparisons=tables.read(evaluation / "planning/comparisons.parquet", tidy.ANY_COMPARISONS),
        intervals=tables.read(evaluation / "planning/intervals.parquet", tidy.INTERVALS),
        failures=tables.read(evaluation / "planning/failures.parquet", tidy.FAILURES),
        estimates=arrays.load(evaluation / "estimates.zarr", arrays.ESTIMATES),
        predictions=arrays.load(evaluation / "predictions.zarr", arrays.PREDICTIONS),
        sessions=record.load(evaluation / f"planning/sessions_{settings.planners[0]}.zarr"),
        camera_estimation=tables.read(evaluation / "camera/estimation.parquet", tidy.CAMERA_ESTIMATION),
        camera_planning=tables.read(evaluation / "camera/planning.parquet", tidy.CAMERA_PLANNING),
        camera_comparisons=tables.read(evaluation / "camera/comparisons.parquet", tidy.ANY_COMPARISONS),
        pictures=arrays.load(evaluation / "camera/pictures.zarr", arrays.PICTURES),
        probes=probes,
        doubt=doubt.summary(probes),
        trust=tables.read(evaluation / "trust.parquet", tidy.TRUST),
        goals=tables.read(evaluation / "goals.parquet", goals_tidy.TABLE) if settings.goals else None,
        goal_pictures=arrays.load(evaluation / "goals.zarr", goals_tidy.PICTURED) if settings.goals else None,
    )
