"""Effect of a depth camera's view and noise on estimates, compared to noise-free voxels of the mesh (section 6.5)."""

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from tqdm import tqdm

from clothkit.cloth import voxels
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.dataset.store import STATES, Dataset
from clothkit.episodes.depth_camera import with_viewport
from clothkit.estimation.alarms import Alarms, signs
from clothkit.estimation.estimate import estimate
from clothkit.estimation.refine import RefineConfig
from clothkit.evaluation.camera_settings import UNMEASURED, Condition, EvaluateCameraConfig
from clothkit.evaluation.errors import errors
from clothkit.models.net import Net
from clothkit.models.vtm import seen_by
from clothkit.observation.coverage import goal_iou
from clothkit.observation.picture import Picture, PictureConfig, take
from clothkit.planning.batches import in_batches
from clothkit.runtime.errors import InputError
from clothkit.runtime.resumable import array_storage, resumable_map

NO_CAMERA = Condition(name="voxels")
"""The condition without a camera: noise-free voxels, the input of all other evaluations."""

TOGETHER = 24
"""Batch size of the estimation, in states."""


class Observations(NamedTuple):
    """Observations of states under one condition, and the meshes that are estimated from them."""

    voxels: Bool[np.ndarray, "states 32 32 16"]
    """All False where no picture showed a cloth."""
    centre_error: Float[np.ndarray, " states"]
    """Distance of the observed centre from the true one, in cloth lengths."""
    iou: Float[np.ndarray, " states"]
    """Intersection over union of the points' silhouette and the true one."""
    mesh: Float[np.ndarray, "states u v 3"]
    """Refined estimates."""
    height: Float[np.ndarray, "stored row column"]
    """Height of each pixel above the table [m] in the pictures of those states that are stored for figures.

    UNMEASURED where the camera measured nothing; empty without a camera.
    """


OBSERVATIONS = array_storage(Observations)
"""Storage of the observations under one condition in a work directory."""


class Estimation(NamedTuple):
    """Results of the evaluation of estimates under every condition."""

    rows: pd.DataFrame
    arrays: dict[str, np.ndarray]
    """Pictures, voxels and estimates of some states under every condition, for figures."""


def picture_settings(settings: EvaluateCameraConfig, condition: Condition) -> PictureConfig:
    """Return the picture settings of a condition."""
    noise = settings.picture.noise
    return dataclasses.replace(
        settings.picture,
        camera=dataclasses.replace(settings.picture.camera, tilt=condition.tilt),
        noise=noise.times(condition.noise) if noise and condition.noise else None,
    )


def observe(
    meshes: Float[np.ndarray, "states u v 3"],
    cloth: Float[np.ndarray, "states 3"],
    vtm: Net,
    condition: Condition,
    settings: EvaluateCameraConfig,
    refinement: RefineConfig,
    *,
    stored: list[int],
) -> Observations:
    """Observe meshes (normalised, centred) under a condition, and estimate them from what was observed.

    `cloth` are the cloths' sides and thicknesses.
    `stored` lists the indices of the states whose heights are returned.
    """
    if condition == NO_CAMERA:
        occupied = np.asarray(seen_by(vtm, meshes))
        centre_error, overlap = np.zeros(len(meshes)), np.ones(len(meshes))
        height = np.zeros((0, 0, 0), np.float32)
    else:
        condition_settings = with_viewport(picture_settings(settings, condition), vtm.config.viewport)
        occupied = np.zeros((len(meshes), *voxels.RESOLUTION), bool)
        centre_error, overlap = np.full((2, len(meshes)), np.nan)
        camera = condition_settings.camera
        height = np.full((len(stored), camera.rows, camera.columns), UNMEASURED, np.float32)
        first: dict[bytes, int] = {}  # flat cloths are many, and all of their pictures are the same
        for number, mesh in enumerate(tqdm(meshes, desc=condition.name, unit="picture", leave=False)):
            same = first.setdefault(mesh.tobytes(), number)
            if same < number and number not in stored:
                occupied[number], overlap[number] = occupied[same], overlap[same]
                centre_error[number] = centre_error[same]
                continue
            try:
                picture = take(mesh, condition_settings)
            except InputError:
                continue
            occupied[number] = picture.observation.voxels
            centre_error[number] = np.linalg.norm(picture.shift) / CLOTH_LENGTH
            overlap[number] = goal_iou(mesh, picture.observation.points)
            if number in stored:
                height[stored.index(number)] = _height(picture)

    def estimated(seen: np.ndarray, cloth: np.ndarray) -> jax.Array:
        return estimate(vtm, seen, refinement, cloth=cloth).mesh

    mesh = in_batches(estimated, TOGETHER, occupied, cloth)
    return Observations(occupied, centre_error, overlap, mesh, height)


def _height(picture: Picture) -> Float[np.ndarray, "row column"]:
    """Return the height above the table [m] of each pixel, UNMEASURED where the camera measured nothing."""
    image = picture.image
    heights = image.camera.table().heights(image.points())
    return np.where(image.depth > 0, heights, UNMEASURED).astype(np.float32)


def estimation(
    dataset: Dataset,
    vtm: Net,
    settings: EvaluateCameraConfig,
    refinement: RefineConfig,
    alarms: Alarms,
    *,
    work: Path,
) -> Estimation:
    """Estimate every state except the flat one of the first test sequences, under every condition and without a camera.

    Columns of the tidy rows: condition, tilt [rad], noise, sequence, state, seen (whether a picture showed a cloth),
    voxel_error (mean difference to the noise-free voxels), centre_error [cloth length], iou (of the points' silhouette
    and the true one), error (of the refined estimate [cloth length], not aligned beyond the centring). These four
    are NaN where seen is false. alarm: whether a state that is seen raises an alarm. `work` stores the conditions that
    are finished, from which an interrupted run resumes.
    """
    chosen = dataset.indices("test", evaluated=True)[: settings.estimated]
    place = [(s, state) for s in chosen.tolist() for state in range(1, min(STATES, int(dataset.length[s]) + 1))]
    sequence, state = np.array(place).T
    truth, cloth = dataset.vertices[sequence, state], dataset.cloth[sequence]
    # Stored states are alternately those after one, two and three manipulations, or the last of a shorter sequence.
    stored = [
        place.index((s, min(1 + number % (STATES - 1), int(dataset.length[s]))))
        for number, s in enumerate(chosen[: settings.stored].tolist())
    ]
    conditions = (NO_CAMERA, *settings.conditions)
    with tqdm(total=len(conditions) * len(truth), desc="camera", unit="state") as bar:
        finished = resumable_map(
            lambda condition: observe(truth, cloth, vtm, condition, settings, refinement, stored=stored),
            conditions,
            folder=work,
            name="observations",
            storage=OBSERVATIONS,
            bar=bar,
            count=lambda observed: len(observed.voxels),
        )
        observations = [observed for _, observed in finished]
    clean = observations[0].voxels
    rows = []
    for condition, observed in zip(conditions, observations, strict=True):
        seen = observed.voxels.any((1, 2, 3))
        measures = {
            "voxel_error": (observed.voxels != clean).mean((1, 2, 3)),
            "centre_error": observed.centre_error,
            "iou": observed.iou,
            "error": np.asarray(errors(observed.mesh, truth, cloth=cloth)),
        }
        columns: dict[str, Any] = {"condition": condition.name, "tilt": condition.tilt, "noise": condition.noise}
        columns |= {"sequence": sequence, "state": state, "seen": seen}
        columns |= {name: np.where(seen, values, np.nan) for name, values in measures.items()}
        columns["alarm"] = seen & alarms.raised(signs(vtm, alarms.support, observed.voxels, observed.mesh, cloth))
        rows.append(pd.DataFrame(columns))
    views = [(observed.height, observed.voxels[stored], observed.mesh[stored]) for observed in observations[1:]]
    height, occupied, meshes = (np.stack(parts, axis=1) for parts in zip(*views, strict=True))
    arrays = {"height": height, "voxels": occupied, "mesh": meshes}
    return Estimation(
        pd.concat(rows, ignore_index=True), {"sequence": sequence[stored], "shown": state[stored], **arrays}
    )
