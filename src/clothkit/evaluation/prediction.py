"""Evaluation of the forward models' predictions: tables 3 to 5, figure 10 (section 6.2)."""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from tqdm import tqdm

from clothkit.cloth import voxels
from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.cloth.voxels import VIEWPORT, Viewport
from clothkit.dataset.store import SPLITS, STATES, STEPS, Dataset
from clothkit.dataset.tasks import TASKS
from clothkit.evaluation.errors import errors, relabelled, sigma_ratio
from clothkit.evaluation.occupancy import TALL, TALL_MEASURE, differences, occluded_occupancy, occupancy
from clothkit.evaluation.settings import EvaluatePredictionConfig
from clothkit.models import forward
from clothkit.models.ensemble import Ensemble
from clothkit.models.net import Net
from clothkit.runtime.errors import InputError

OCCLUDED = "main_occluded"
"""System name of main's predictions as a camera above would see them, comparable to the voxel baseline's."""


class Starts(NamedTuple):
    """Each system's initial states for n evaluated sequences [normalised], NaN past a sequence's end.

    All meshes have the labels of the truth, by which the recorded manipulations are labelled; estimates are therefore
    relabelled to their best match (design 6.10).
    """

    sequence: Int[np.ndarray, " n"]
    meshes: Mapping[str, Float[np.ndarray, "n state u v 3"]]
    """main: the refined estimates; a1: the true meshes."""


def starts(dataset: Dataset, estimates: Mapping[str, np.ndarray]) -> Starts:
    """Return the starts of main and a1, from the arrays sequence, mesh and label of estimates.zarr.

    Raises InputError if a state has no estimate.
    """
    sequence, mesh, label = estimates["sequence"], estimates["mesh"], estimates["label"]
    missing = (label < 0) & (np.arange(STATES) <= dataset.length[sequence, None])
    if missing.any():
        place, state = np.argwhere(missing)[0]
        raise InputError(f"estimates: expected one of state {state} of sequence {sequence[place]}, found none")
    joined = np.asarray(relabelled(mesh.reshape(-1, *mesh.shape[2:]), np.maximum(label, 0).reshape(-1)))
    return Starts(sequence, {"main": joined.reshape(mesh.shape), "a1": dataset.vertices[sequence]})


def rows(dataset: Dataset, initial: Starts, ensemble: Ensemble, settings: EvaluatePredictionConfig) -> pd.DataFrame:
    """Return tidy rows, one per system, net, sequence and task.

    The columns are split, system, net (the member: "0", "1", ..), better (whether the net has the best validation
    score), sequence, start, length, error, error_no_action, position_error, position_no_action [cloth length],
    sigma_ratio, voxel_error, voxel_error_no_action, voxel_error_025, voxel_error_025_no_action [mean voxel difference,
    0..1; the last two in the viewport that is `TALL`].

    error is not aligned beyond the centring; error_no_action is aligned (design 2). position_error is the error of the
    predicted centre shift, eq. (7); position_no_action is the length of the true shift. For the voxel columns,
    predictions are converted by eq. (16), and the voxels of true states are undoubled, free of noise and unoccluded
    (design 6.14). The rows of main's best net are repeated as system `OCCLUDED`, with all voxels as a camera would
    see them (`occluded_occupancy`) and with error and sigma_ratio NaN.
    """
    tidy = []
    jobs = [(system, k, task) for system in initial.meshes for k in range(len(ensemble.nets)) for task in TASKS]
    for system, k, (start, length) in tqdm(jobs, desc="predictions", unit="task"):
        end = start + length
        long = dataset.length[initial.sequence] >= end
        sequence = initial.sequence[long]
        if not len(sequence):
            continue
        truth = dataset.vertices[sequence, end]
        manipulations = dataset.manipulation[sequence, start:end]
        state, cloth = initial.meshes[system][long, start], dataset.cloth[sequence]
        predicted, shift = predict(ensemble.nets[k], state, manipulations, settings.batch, cloth)
        final = ProbabilisticMesh(predicted.mean[-1], predicted.std[-1])
        moved = dataset.centre[sequence, end] - dataset.centre[sequence, start]
        first = dataset.vertices[sequence, start]
        found = pd.DataFrame(
            {
                "split": [SPLITS[code] for code in dataset.split[sequence]],
                "system": system,
                "net": str(ensemble.members[k]),
                "better": k == ensemble.best,
                "sequence": sequence,
                "start": start,
                "length": length,
                "error": np.asarray(errors(final.mean, truth, cloth=cloth)),
                "error_no_action": np.asarray(errors(first, truth, aligned=True, cloth=cloth)),
                "position_error": np.linalg.norm(shift.sum(0) - moved, axis=-1) / CLOTH_LENGTH,
                "position_no_action": np.linalg.norm(moved, axis=-1) / CLOTH_LENGTH,
                "sigma_ratio": np.asarray(sigma_ratio(final, truth, cloth=cloth)),
                **_in_voxels(final, first, truth, settings.batch),
            }
        )
        tidy.append(found)
        if system == "main" and k == ensemble.best:
            unknown = {"error": np.float32(np.nan), "sigma_ratio": np.float32(np.nan)}
            occluded = _in_voxels(final, first, truth, settings.batch, occluded=True)
            tidy.append(found.assign(system=OCCLUDED, **unknown, **occluded))
    return pd.concat(tidy, ignore_index=True)


def stored(dataset: Dataset, initial: Starts, net: Net, settings: EvaluatePredictionConfig) -> dict[str, np.ndarray]:
    """Return main's predictions after 1, 2 and 3 manipulations, for the first sequences of each split.

    The arrays are sequence, start (the initial mesh), mean, std [normalised] and shift (each step's centre shift, xy),
    NaN past a sequence's end.
    """
    split = dataset.split[initial.sequence]
    first = np.sort(np.concatenate([np.flatnonzero(split == name)[: settings.stored] for name in np.unique(split)]))
    start = initial.meshes["main"][first, 0]
    manipulations = np.nan_to_num(dataset.manipulation[initial.sequence[first]])
    cloth = dataset.cloth[initial.sequence[first]]
    predicted, shift = predict(net, start, manipulations, settings.batch, cloth)
    mean, std = (np.array(part) for part in predicted)
    for values in (mean, std, shift):
        values[np.arange(STEPS)[:, None] >= dataset.length[initial.sequence[first]]] = np.nan
    steps = {"mean": mean, "std": std, "shift": shift}
    by_sequence = {name: np.moveaxis(values, 0, 1) for name, values in steps.items()}
    return {"sequence": initial.sequence[first], "start": start, **by_sequence}


def predict(
    net: Net, mesh: np.ndarray, manipulations: np.ndarray, batch: int, cloth: np.ndarray
) -> tuple[ProbabilisticMesh, Float[np.ndarray, "step n 2"]]:
    """Return the probabilistic meshes [step n u v 3] and the centre shift of each step, computed in equal batches."""
    parts = []
    for first in range(0, len(mesh), batch):
        chosen = np.minimum(np.arange(first, first + batch), len(mesh) - 1)
        kept = min(batch, len(mesh) - first)
        predicted, shift = _predict(net, mesh[chosen], manipulations[chosen], cloth[chosen])
        parts.append([np.asarray(a)[:, :kept] for a in (*predicted, shift)])
    mean, std, shift = (np.concatenate(values, axis=1) for values in zip(*parts, strict=True))
    return ProbabilisticMesh(mean, std), shift


def _in_voxels(
    predicted: ProbabilisticMesh,
    first: Float[np.ndarray, "n u v 3"],
    truth: Float[np.ndarray, "n u v 3"],
    batch: int,
    *,
    occluded: bool = False,
) -> dict[str, np.ndarray]:
    """Return the mean voxel differences [n] of predictions and of no action to the truth, in both viewports, by name.

    With `occluded`, predictions, start and truth are as a camera above sees them.
    """
    found = {}
    for name, viewport in (("voxel_error", VIEWPORT), (TALL_MEASURE, TALL)):
        occupied, start = (
            np.asarray((voxels.observe if occluded else voxels.of_mesh)(m, viewport=viewport)) for m in (truth, first)
        )
        found[name] = _voxel_errors(predicted, occupied, batch, viewport=viewport, occluded=occluded)
        found[f"{name}_no_action"] = np.asarray(differences(start, occupied))
    return found


def _voxel_errors(
    mesh: ProbabilisticMesh, truth: Bool[np.ndarray, "n 32 32 16"], batch: int, *, viewport: Viewport, occluded: bool
) -> np.ndarray:
    """Return the mean voxel differences [n] of predicted meshes, in batches of one size to bound the memory."""
    parts = []
    for first in range(0, len(truth), batch):
        chosen = np.minimum(np.arange(first, first + batch), len(truth) - 1)
        some = ProbabilisticMesh(mesh.mean[chosen], mesh.std[chosen])
        if occluded:
            predicted = occluded_occupancy(some, viewport=viewport, key=jax.random.key(first))
        else:
            predicted = occupancy(some, viewport=viewport)
        parts.append(np.asarray(differences(predicted, truth[chosen]))[: len(truth) - first])
    return np.concatenate(parts)


@jax.jit
def _predict(
    net: Net, mesh: jax.Array, manipulations: jax.Array, cloth: jax.Array
) -> tuple[ProbabilisticMesh, jax.Array]:
    model = forward.forward_model(net.config)
    predicted, found = forward.predict(model, net.params, mesh, manipulations, cloth=cloth, unroll=True)
    return predicted, found.shifts
