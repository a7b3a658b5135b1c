"""Effect of a depth camera's view and noise on plans, compared to planning on noise-free voxels (section 6.5)."""

import contextlib
import dataclasses
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from clothkit.cloth.silhouette import iou, silhouette
from clothkit.dataset.store import Dataset
from clothkit.episodes.depth_camera import depth_camera
from clothkit.episodes.evaluate import evaluate
from clothkit.episodes.record import Sessions
from clothkit.episodes.sessions import Execute
from clothkit.evaluation.camera import NO_CAMERA, picture_settings
from clothkit.evaluation.camera_settings import Condition, EvaluateCameraConfig
from clothkit.evaluation.comparisons import COLUMNS, compare
from clothkit.evaluation.diagnosis import diagnosed
from clothkit.evaluation.session_rows import rows
from clothkit.observation.coverage import goal_iou
from clothkit.observation.picture import PictureConfig, take
from clothkit.planning.planner import Planner
from clothkit.runtime.errors import InputError


def planning(
    dataset: Dataset,
    planner: Planner,
    execute: Execute,
    baseline: Sessions,
    settings: EvaluateCameraConfig,
    *,
    work: Path,
) -> pd.DataFrame:
    """Run sessions of the first test sequences under every condition; return tidy rows of planning with extra columns.

    The extra columns are condition, tilt [rad], noise, iou (of the outcome's true silhouette and the goal's),
    iou_no_action (of the start's silhouette and the goal's) and iou_seen (of the silhouette of the points in a final
    picture and the goal's, NaN if the picture shows no cloth). `baseline` holds the same planner's sessions without a
    camera, whose searches use the same random draws, so that tasks can be compared in pairs. `work` stores finished
    parts, from which an interrupted run resumes. Raises InputError if `baseline` lacks one of the test sequences.
    """
    chosen = dataset.indices("test", evaluated=True)[: settings.planned]
    missing = np.setdiff1d(chosen, baseline.sequence[baseline.split == "test"])
    if len(missing):
        raise InputError(
            f"evaluate_camera.planned: {settings.planned} sequences, but {len(missing)} of them were not planned for "
            "without a camera (plan.test)"
        )
    found = [_condition_rows(_select_sequences(baseline, chosen), NO_CAMERA, None)]
    test_settings = dataclasses.replace(planner.settings, test=len(chosen), train=0)
    for condition in settings.conditions:
        picture = picture_settings(settings, condition)
        camera_planner = dataclasses.replace(planner, settings=test_settings)
        sessions, _ = evaluate(
            dataset,
            camera_planner,
            execute,
            work=work / condition.name,
            sensor=depth_camera(picture, planner.perception),
            annotate=partial(diagnosed, planner=camera_planner),
            refined=False,
        )
        found.append(_condition_rows(sessions.whole(), condition, picture))
    return pd.concat(found, ignore_index=True)


def comparisons(tidy: pd.DataFrame) -> pd.DataFrame:
    """Compare the errors of every condition with those without a camera, by `comparisons.compare`."""
    named = tidy.assign(system=tidy["condition"])
    conditions = [name for name in tidy["condition"].unique() if name != NO_CAMERA.name]
    found = [compare(named, "error", condition, NO_CAMERA.name) for condition in conditions]
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame(columns=list(COLUMNS))


def _select_sequences(sessions: Sessions, sequences: np.ndarray) -> Sessions:
    """Return the sessions of the given sequences."""
    chosen = np.isin(sessions.sequence, sequences)
    return Sessions(**{name: values[chosen] for name, values in vars(sessions).items()})


def _condition_rows(sessions: Sessions, condition: Condition, picture: PictureConfig | None) -> pd.DataFrame:
    outcome = sessions.state[np.arange(len(sessions)), sessions.length]
    goals = [silhouette(goal) for goal in sessions.goal]
    iou_seen = np.full(len(sessions), np.nan)
    if picture is not None:
        for number, mesh in enumerate(outcome):
            with contextlib.suppress(InputError):
                iou_seen[number] = goal_iou(sessions.goal[number], take(mesh, picture).observation.points)
    return rows(sessions, "main").assign(
        condition=condition.name,
        tilt=condition.tilt,
        noise=condition.noise,
        iou=[iou(silhouette(mesh), goal) for mesh, goal in zip(outcome, goals, strict=True)],
        iou_no_action=[iou(silhouette(mesh), goal) for mesh, goal in zip(sessions.state[:, 0], goals, strict=True)],
        iou_seen=iou_seen,
    )
