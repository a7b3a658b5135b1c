"""Effect of a depth camera's view and noise on estimates, compared to noise-free voxels of the mesh (section 6.5)."""

import dataclasses
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from tqdm import tqdm

from clothkit.cloth import voxels
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.dataset.store import STATES, Dataset
from clothkit.episodes.sensors import with_height
from clothkit.errors import InputError
from clothkit.estimation.estimate import estimate
from clothkit.estimation.refine import RefineConfig
from clothkit.evaluation.arrays import Named
from clothkit.evaluation.camera_settings import UNMEASURED, Condition, EvaluateCameraConfig
from clothkit.evaluation.errors import errors
from clothkit.models.net import Net
from clothkit.models.vtm import seen_by
from clothkit.observation.coverage import goal_iou
from clothkit.observation.picture import Picture, PictureConfig, take
from clothkit.planning.batches import in_batches

NO_CAMERA = Condition(name="voxels")
"""The condition without a camera: noise-free voxels, the input of all other evaluations."""

TOGETHER = 24
"""Batch size of the estimation, in states."""


class Looked(NamedTuple):
    """Observations of states under one condition."""

    voxels: Bool[np.ndarray, "states 32 32 16"]
    """All False where no picture showed a cloth."""
    off: Float[np.ndarray, " states"]
    """Distance of the observed centre from the true one, in cloth lengths."""
    iou: Float[np.ndarray, " states"]
    """Intersection over union of the points' silhouette and the true one."""
    kept: list[Picture | None]
    """Pictures of the states in `keep`; None where no picture showed a cloth."""


class Estimation(NamedTuple):
    """Results of the evaluation of estimates under every condition."""

    rows: pd.DataFrame
    arrays: dict[str, Named]
    """Pictures, voxels and estimates of some states under every condition, for figures."""


def pictured(settings: EvaluateCameraConfig, condition: Condition) -> PictureConfig:
    """Return the picture settings of a condition."""
    noise = settings.picture.noise
    return dataclasses.replace(
        settings.picture,
        camera=dataclasses.replace(settings.picture.camera, tilt=condition.tilt),
        noise=noise.times(condition.noise) if noise and condition.noise else None,
    )


def look(meshes: Float[np.ndarray, "states u v 3"], settings: PictureConfig, *, keep: list[int], what: str) -> Looked:
    """Take a picture of each mesh (normalised, centred) and return the observations.

    `keep` lists the indices whose pictures are returned; `what` labels the progress bar.
    """
    seen = np.zeros((len(meshes), *voxels.RESOLUTION), bool)
    off, overlap = np.full((2, len(meshes)), np.nan)
    kept: dict[int, Picture | None] = dict.fromkeys(keep)
    for number, mesh in enumerate(tqdm(meshes, desc=what, unit="picture")):
        try:
            picture = take(mesh, settings)
        except InputError:
            continue
        seen[number] = picture.observation.voxels
        off[number] = np.linalg.norm(picture.shift) / CLOTH_LENGTH
        overlap[number] = goal_iou(mesh, picture.observation.points)
        if number in kept:
            kept[number] = picture
    return Looked(seen, off, overlap, [kept[number] for number in keep])


def estimation(dataset: Dataset, vtm: Net, settings: EvaluateCameraConfig, refinement: RefineConfig) -> Estimation:
    """Estimate every state except the flat one of the first test sequences, under every condition and without a camera.

    Columns of the tidy rows: condition, tilt [rad], noise, sequence, state, seen (whether a picture showed a cloth),
    voxel_error (mean difference to the noise-free voxels), centre_error [cloth length], iou (of the points' silhouette
    and the true one), error (of the refined estimate [cloth length], not aligned beyond the centring). The last four
    are NaN where seen is false.
    """
    chosen = dataset.indices("test", evaluated=True)[: settings.estimated]
    place = [(s, state) for s in chosen.tolist() for state in range(1, min(STATES, int(dataset.length[s]) + 1))]
    sequence, state = np.array(place).T
    truth = dataset.vertices[sequence, state]
    clean = np.asarray(seen_by(vtm, truth))
    # Stored states are alternately those after one, two and three manipulations, or the last of a shorter sequence.
    stored = [
        place.index((s, min(1 + number % (STATES - 1), int(dataset.length[s]))))
        for number, s in enumerate(chosen[: settings.stored].tolist())
    ]
    found, views = [], []
    for condition in (NO_CAMERA, *settings.conditions):
        if condition is NO_CAMERA:
            none = np.zeros(len(truth))
            looked = Looked(clean, none, none + 1, [])
        else:
            looked = look(
                truth, with_height(pictured(settings, condition), vtm.config.height), keep=stored, what=condition.name
            )
        mesh = in_batches(lambda seen: estimate(vtm, seen, refinement).mesh, TOGETHER, looked.voxels)
        seen = looked.voxels.any((1, 2, 3))
        measures = {
            "voxel_error": (looked.voxels != clean).mean((1, 2, 3)),
            "centre_error": looked.off,
            "iou": looked.iou,
            "error": np.asarray(errors(mesh, truth)),
        }
        of_condition = {"condition": condition.name, "tilt": condition.tilt, "noise": condition.noise}
        told = {name: np.where(seen, values, np.nan) for name, values in measures.items()}
        found.append(pd.DataFrame({**of_condition, "sequence": sequence, "state": state, "seen": seen, **told}))
        if condition is not NO_CAMERA:
            views.append((_heights(looked.kept, settings), looked.voxels[stored], mesh[stored]))
    height, occupied, meshes = (np.stack(parts, axis=1) for parts in zip(*views, strict=True))
    arrays = {
        "sequence": Named(sequence[stored], ("sequence",)),
        "shown": Named(state[stored], ("sequence",)),
        "height": Named(height, ("sequence", "condition", "row", "column")),
        "voxels": Named(occupied, ("sequence", "condition", "x", "y", "z")),
        "mesh": Named(meshes, ("sequence", "condition", "u", "v", "xyz")),
    }
    return Estimation(pd.concat(found, ignore_index=True), arrays)


def _heights(
    pictures: list[Picture | None], settings: EvaluateCameraConfig
) -> Float[np.ndarray, "sequence row column"]:
    """Return each pixel's height above the table, in metres; UNMEASURED where the camera measured nothing."""
    camera = settings.picture.camera
    found = np.full((len(pictures), camera.rows, camera.columns), UNMEASURED, np.float32)
    for number, picture in enumerate(pictures):
        if picture is not None:
            image = picture.image
            heights = image.camera.table().heights(image.points())
            found[number] = np.where(image.depth > 0, heights, UNMEASURED)
    return found
