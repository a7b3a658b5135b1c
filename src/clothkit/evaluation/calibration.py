"""Whether stated uncertainty is the actual one: coverage curves of predictions and estimates (sections 6.1 and 6.2)."""

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
from clothkit.networks.net import Net

LEVELS = np.round(np.arange(1, 31) * 0.1, 1)
"""z: the multiples of sigma at which coverage is measured."""

AXES = {"all": slice(0, 3), "xy": slice(0, 2), "z": slice(2, 3)}
"""Coordinates that are counted."""

ESTIMATE = "estimate"
"""The system of the rows that are about VtM's estimates."""


def curve(deviation: Float[np.ndarray, "n u v 3"]) -> pd.DataFrame:
    """Coverage of n probabilistic meshes from their coordinates' abs(error) / sigma: axis, z, expected, coverage.

    A row per axis (all, xy, z) and level z. coverage: the share of coordinates with abs(error) < z sigma; expected:
    that of a normal distribution, which well calibrated meshes have too.
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
    """Tidy rows: split, system, length, axis, z, expected, coverage (`curve`).

    main and a1: the net's predictions after `length` manipulations, from every start. estimate: what VtM gives for
    the state after `length` manipulations (arrays mean and std of estimates.zarr, in the order of `given.sequence`).
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
            # One rollout answers every length from this start; what lies past a sequence's end is not counted.
            manipulations = np.nan_to_num(dataset.manipulation[given.sequence[long], start:])
            predicted, _ = predict(net, meshes[long, start], manipulations, settings.batch)
            for step in range(STEPS - start):
                inside = dataset.length[given.sequence[long]] > start + step
                if inside.any():
                    probabilistic = ProbabilisticMesh(predicted.mean[step, inside], predicted.std[step, inside])
                    truth = dataset.vertices[given.sequence[long[inside]], start + step + 1]
                    collect(system, step + 1, long[inside], np.asarray(deviations(probabilistic, truth)))
    for state in range(1, STATES):
        long = np.flatnonzero(dataset.length[given.sequence] >= state)
        if len(long):
            probabilistic = ProbabilisticMesh(estimates["mean"][long, state], estimates["std"][long, state])
            truth = dataset.vertices[given.sequence[long], state]
            collect(ESTIMATE, state, long, np.asarray(deviations(probabilistic, truth)))
    tidy = [
        curve(np.concatenate(parts)).assign(split=SPLITS[code], system=system, length=length)
        for (code, system, length), parts in found.items()
    ]
    return pd.concat(tidy, ignore_index=True)[["split", "system", "length", "axis", "z", "expected", "coverage"]]
