"""Evaluation of the estimation of meshes from voxels: table 2, figure 9 (section 6.1)."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from tqdm import tqdm

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.dataset.store import SPLITS, STATES, Dataset
from clothkit.estimation.estimate import LEAST_PROBABLE, Alternatives, alternatives
from clothkit.estimation.refine import RefineConfig
from clothkit.evaluation.errors import errors, labelled_errors, labels_of_truth, sigma_ratio
from clothkit.evaluation.settings import EvaluateEstimationConfig
from clothkit.models.hypotheses import DISTINCT, most_probable
from clothkit.models.net import Net
from clothkit.models.vtm import seen_by


class Estimates(NamedTuple):
    """Estimates of the states of n evaluated sequences, in the labelling that VtM returned [normalised].

    Past a sequence's end, floats are NaN and labels -1.
    """

    sequence: Int[np.ndarray, " n"]
    """Index into the dataset."""
    mean: Float[np.ndarray, "n state u v 3"]
    std: Float[np.ndarray, "n state u v 3"]
    mesh: Float[np.ndarray, "n state u v 3"]
    """The refined mesh."""
    label: Int[np.ndarray, "n state"]
    """The equivalent that relabels the refined mesh to the truth's labels; for evaluation and pictures only."""
    hypotheses: Int[np.ndarray, "n state"]
    """Number of distinct hypotheses: the chosen one, and those that may be true and differ from it."""
    probability: Float[np.ndarray, "n state"]
    """Of the chosen hypothesis, with which the other arrays deal."""
    best_mean: Float[np.ndarray, "n state"]
    """Error of the best of the distinct hypotheses' means [cloth length]."""
    best_mesh: Float[np.ndarray, "n state"]
    """Error of the best of their refined meshes."""


def estimates(dataset: Dataset, net: Net, settings: EvaluateEstimationConfig, refinement: RefineConfig) -> Estimates:
    """Return VtM's estimate and the refined mesh of every state of every evaluated sequence.

    VtM's input voxels are doubled, occluded and free of noise (design 6.14).
    """
    sequence = np.flatnonzero(dataset.evaluated)
    present = np.arange(STATES) <= dataset.length[sequence, None]
    truth, cloth = dataset.vertices[sequence][present], dataset.cloth[sequence[np.nonzero(present)[0]]]
    parts: list[tuple[np.ndarray, ...]] = []
    for start in tqdm(range(0, len(truth), settings.batch), desc="estimates", unit="batch"):
        # The last batch is padded to the same size, which avoids another compilation.
        chosen = np.minimum(np.arange(start, start + settings.batch), len(truth) - 1)
        # All hypotheses are refined to choose one, so telling of the others costs their errors only.
        found = alternatives(net, seen_by(net, truth[chosen]), refinement, cloth=cloth[chosen])
        label = labels_of_truth(found.mesh[:, 0], truth[chosen], cloth=cloth[chosen])
        kept = min(settings.batch, len(truth) - start)
        told = (*most_probable(found.found), found.mesh[:, 0], label, *_compared(found, truth[chosen], cloth[chosen]))
        parts.append(tuple(np.asarray(a)[:kept] for a in told))
    return Estimates(sequence, *(_placed(np.concatenate(values), present) for values in zip(*parts, strict=True)))


def _compared(
    found: Alternatives, truth: Float[np.ndarray, "batch u v 3"], cloth: Float[np.ndarray, "batch 3"]
) -> tuple[np.ndarray, ...]:
    """The arrays hypotheses, probability, best_mean and best_mesh of `Estimates`, each `[batch]`."""
    probability, mean, mesh = (
        np.asarray(part) for part in (found.found.probability, found.found.mesh.mean, found.mesh)
    )
    each = range(probability.shape[1])
    away = np.stack([np.asarray(errors(mean[:, i], mean[:, 0], cloth=cloth)) for i in each], axis=1)
    counts = (probability >= LEAST_PROBABLE) & (away >= DISTINCT)
    counts[:, 0] = True
    best = []
    for shapes in (mean, mesh):
        wrong = np.stack([np.asarray(errors(shapes[:, i], truth, cloth=cloth)) for i in each], axis=1)
        best.append(np.where(counts, wrong, np.inf).min(axis=1))
    return counts.sum(axis=1), probability[:, 0], *best


def _placed(values: np.ndarray, present: Bool[np.ndarray, "n state"]) -> np.ndarray:
    """Return the values placed where `present` is True, [n state ...], with NaN (-1 for labels) elsewhere."""
    placed = np.full((*present.shape, *values.shape[1:]), np.nan if values.dtype.kind == "f" else -1, values.dtype)
    placed[present] = values
    return placed


def rows(dataset: Dataset, found: Estimates) -> pd.DataFrame:
    """Return tidy rows with the columns split, sequence, state (1..3), kind (pmr, dmr), the errors, sigma_ratio,
    hypotheses, probability and error_best.

    error and error_labelled are in cloth lengths, not aligned beyond the centring. error_no_action is the error of the
    previous state, aligned (design 2). The flat state is left out, as in section 6.1. sigma_ratio is that of the pmr,
    also in the rows of the dmr. hypotheses counts the distinct ones, probability is that of the chosen one, and
    error_best is the error of the best one, all as in `Estimates`.
    """
    tidy = []
    for state in range(1, STATES):
        long = dataset.length[found.sequence] >= state
        sequence = found.sequence[long]
        if not len(sequence):
            continue
        truth, cloth = dataset.vertices[sequence, state], dataset.cloth[sequence]
        probabilistic = ProbabilisticMesh(found.mean[long, state], found.std[long, state])
        kinds = (("pmr", probabilistic.mean, found.best_mean), ("dmr", found.mesh[long, state], found.best_mesh))
        for kind, mesh, best in kinds:
            tidy.append(
                pd.DataFrame(
                    {
                        "split": [SPLITS[code] for code in dataset.split[sequence]],
                        "sequence": sequence,
                        "state": state,
                        "kind": kind,
                        "error": np.asarray(errors(mesh, truth, cloth=cloth)),
                        "error_labelled": np.asarray(labelled_errors(mesh, truth)),
                        "error_no_action": np.asarray(
                            errors(dataset.vertices[sequence, state - 1], truth, aligned=True, cloth=cloth)
                        ),
                        "sigma_ratio": np.asarray(sigma_ratio(probabilistic, truth, cloth=cloth)),
                        "hypotheses": found.hypotheses[long, state],
                        "probability": found.probability[long, state],
                        "error_best": best[long, state],
                    }
                )
            )
    return pd.concat(tidy, ignore_index=True).sort_values(["sequence", "state"], kind="stable", ignore_index=True)
