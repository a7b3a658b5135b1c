"""Calibration of the standard deviations of predictions and estimates: coverage curves (sections 6.1 and 6.2)."""

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd
from jaxtyping import Float

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.dataset.store import SPLITS, STATES, STEPS, Dataset
from clothkit.evaluation.errors import deviations
from clothkit.evaluation.prediction import Starts, predict
from clothkit.evaluation.settings import EvaluatePredictionConfig
from clothkit.models.net import Net

LEVELS = np.round(np.arange(1, 31) * 0.1, 1)
"""z: the multiples of sigma at which coverage is measured."""

AXES = {"all": slice(0, 3), "xy": slice(0, 2), "z": slice(2, 3)}
"""The coordinates counted for each value of the column `axis`."""

ESTIMATE = "estimate"
"""The system name in the rows of VtM's estimates."""


def curve(deviation: Float[np.ndarray, "n u v 3"]) -> pd.DataFrame:
    """Return the coverage of n probabilistic meshes, from abs(error) / sigma of their coordinates.

    Returns a row per axis (all, xy, z) and level z, with the columns axis, z, expected and coverage. coverage: the
    fraction of coordinates with abs(error) < z sigma; expected: this fraction for a normal distribution, and so for
    well calibrated meshes.
    """
    rows = []
    for axis, counted in AXES.items():
        ordered = np.sort(deviation[..., counted], axis=None)
        coverage = np.searchsorted(ordered, LEVELS, side="left") / ordered.size
        expected = [math.erf(z / math.sqrt(2)) for z in LEVELS]
        rows.append(pd.DataFrame({"axis": axis, "z": LEVELS, "expected": expected, "coverage": coverage}))
    return pd.concat(rows, ignore_index=True)


def rows(
    dataset: Dataset,
    given: Starts,
    net: Net,
    estimates: Mapping[str, np.ndarray],
    settings: EvaluatePredictionConfig,
) -> pd.DataFrame:
    """Return tidy rows with the columns split, system, length, axis, z, expected and coverage (see `curve`).

    Systems main and a1: the net's predictions after `length` manipulations, over all starts. System estimate: VtM's
    estimate of the state after `length` manipulations (arrays mean and std of estimates.zarr, in the order of
    `given.sequence`).
    """
    split = dataset.split[given.sequence]
    found: dict[tuple[int, str, int], list[np.ndarray]] = {}

    def collect(system: str, length: int, chosen: np.ndarray, deviation: np.ndarray) -> None:
        for code in np.unique(split[chosen]):
            found.setdefault((int(code), system, length), []).append(deviation[split[chosen] == code])

    for system, meshes in given.meshes.items():
        for start in range(STEPS):
            long = np.flatnonzero(dataset.length[given.sequence] > start)
            if not len(long):
                continue
            # One rollout covers all lengths from this start; steps past a sequence's end are not counted.
            manipulations = np.nan_to_num(dataset.manipulation[given.sequence[long], start:])
            cloth = dataset.cloth[given.sequence[long]]
            predicted, _ = predict(net, meshes[long, start], manipulations, settings.batch, cloth)
            for step in range(STEPS - start):
                inside = dataset.length[given.sequence[long]] > start + step
                if inside.any():
                    probabilistic = ProbabilisticMesh(predicted.mean[step, inside], predicted.std[step, inside])
                    truth = dataset.vertices[given.sequence[long[inside]], start + step + 1]
                    found_here = np.asarray(deviations(probabilistic, truth, cloth=cloth[inside]))
                    collect(system, step + 1, long[inside], found_here)
    for state in range(1, STATES):
        long = np.flatnonzero(dataset.length[given.sequence] >= state)
        if len(long):
            probabilistic = ProbabilisticMesh(estimates["mean"][long, state], estimates["std"][long, state])
            truth = dataset.vertices[given.sequence[long], state]
            cloth = dataset.cloth[given.sequence[long]]
            collect(ESTIMATE, state, long, np.asarray(deviations(probabilistic, truth, cloth=cloth)))
    tidy = [
        curve(np.concatenate(parts)).assign(split=SPLITS[code], system=system, length=length)
        for (code, system, length), parts in found.items()
    ]
    return pd.concat(tidy, ignore_index=True)[["split", "system", "length", "axis", "z", "expected", "coverage"]]
