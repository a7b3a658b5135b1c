"""Evaluation of the voxel baseline's predictions: A2 of table 4 (section 6.2)."""

import jax
import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from tqdm import tqdm

from clothkit.cloth import voxels
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.dataset.store import SPLITS, Dataset
from clothkit.dataset.tasks import TASKS
from clothkit.evaluation.errors import errors
from clothkit.evaluation.occupancy import TALL, TALL_MEASURE, differences, pooled
from clothkit.evaluation.settings import EvaluatePredictionConfig
from clothkit.models.emd_voxel import cartesian
from clothkit.models.ensemble import Ensemble
from clothkit.models.forward import forward_model, predict
from clothkit.models.net import Net

SYSTEM = "a2"

_MEASURES = ("voxel_error", "voxel_error_no_action", TALL_MEASURE, f"{TALL_MEASURE}_no_action")


def rows(
    dataset: Dataset,
    sequences: Int[np.ndarray, " n"],
    ensemble: Ensemble,
    settings: EvaluatePredictionConfig,
) -> pd.DataFrame:
    """Return tidy rows of system a2, one per net, sequence and task, with the columns of `prediction.rows`.

    Input and truth are voxels as a camera sees them (doubled, occluded, free of noise), the format that the nets were
    trained on (design 6.14). Therefore voxel_error_no_action differs from that of mesh nets. For the viewport that is
    `TALL`, predictions are converted by `pooled`, while truth and start are observed in that viewport. error and
    sigma_ratio are NaN, since voxels have no vertices.
    """
    tidy = []
    jobs = [(k, task) for k in range(len(ensemble.nets)) for task in TASKS]
    for k, (start, length) in tqdm(jobs, desc="voxel predictions", unit="task"):
        end = start + length
        chosen = sequences[dataset.length[sequences] >= end]
        if not len(chosen):
            continue
        states = dataset.vertices[chosen, start : end + 1]
        manipulations = dataset.manipulation[chosen, start:end]
        measured, shift = _measured(ensemble.nets[k], states, manipulations, settings.batch)
        moved = dataset.centre[chosen, end] - dataset.centre[chosen, start]
        tidy.append(
            pd.DataFrame(
                {
                    "split": [SPLITS[code] for code in dataset.split[chosen]],
                    "system": SYSTEM,
                    "net": str(ensemble.members[k]),
                    "better": k == ensemble.best,
                    "sequence": chosen,
                    "start": start,
                    "length": length,
                    "error": np.float32(np.nan),
                    "error_no_action": np.asarray(
                        errors(states[:, 0], states[:, -1], aligned=True, cloth=dataset.cloth[chosen])
                    ),
                    "position_error": np.linalg.norm(shift.sum(0) - moved, axis=-1) / CLOTH_LENGTH,
                    "position_no_action": np.linalg.norm(moved, axis=-1) / CLOTH_LENGTH,
                    "sigma_ratio": np.float32(np.nan),
                    **measured,
                }
            )
        )
    return pd.concat(tidy, ignore_index=True)


def _measured(
    net: Net, states: Float[np.ndarray, "n state u v 3"], manipulations: Float[np.ndarray, "n step 6"], batch: int
) -> tuple[dict[str, np.ndarray], Float[np.ndarray, "step n 2"]]:
    """Return the voxel differences of predictions and of no action by name, and centre shifts, in equal batches."""
    parts = []
    for first in range(0, len(states), batch):
        chosen = np.minimum(np.arange(first, first + batch), len(states) - 1)
        kept = min(batch, len(states) - first)
        *measured, shift = _differences(net, states[chosen], manipulations[chosen])
        parts.append((*(np.asarray(values)[:kept] for values in measured), np.asarray(shift)[:, :kept]))
    *measured, shift = zip(*parts, strict=True)
    found = {name: np.concatenate(values) for name, values in zip(_MEASURES, measured, strict=True)}
    return found, np.concatenate(shift, axis=1)


@jax.jit
def _differences(net: Net, states: jax.Array, manipulations: jax.Array) -> tuple[jax.Array, ...]:
    """Return the _MEASURES and the centre shifts."""
    start, end = states[:, 0], states[:, -1]
    observed, truth = voxels.observe(start), voxels.observe(end)
    tall_observed, tall_truth = (voxels.observe(mesh, viewport=TALL) for mesh in (start, end))
    model, plan = forward_model(net.config), cartesian(states[:, :-1], manipulations)
    logits, found = predict(model, net.params, observed, plan, unroll=True)
    predicted = jax.nn.sigmoid(logits)
    return (
        differences(predicted[-1], truth),
        differences(observed, truth),
        differences(pooled(predicted[-1]), tall_truth),
        differences(tall_observed, tall_truth),
        found.shifts,
    )
