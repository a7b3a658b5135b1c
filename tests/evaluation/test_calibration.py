"""Coverage curves of made-up errors against what the normal distribution says, and whose errors are counted."""

from statistics import NormalDist

import jax
import numpy as np
import pandas as pd
import pytest

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.symmetry import relabel_batch
from clothkit.cloth.topology import SQUARE
from clothkit.dataset.store import Dataset, papers_cloths
from clothkit.evaluation import calibration
from clothkit.evaluation.errors import deviations
from clothkit.evaluation.prediction import Starts
from clothkit.evaluation.settings import EvaluatePredictionConfig
from clothkit.models import pemd
from clothkit.models.net import Net
from clothkit.models.settings import PEMDConfig
from tests.models.predicted import predicted_by


def normal_coverage(z: pd.Series, factor: float = 1) -> np.ndarray:
    """The share of a normal distribution within factor * z of its standard deviation."""
    return np.array([2 * NormalDist().cdf(factor * level) - 1 for level in z])


def noisy(stated: tuple[float, float, float], meshes: int = 32) -> tuple[ProbabilisticMesh, np.ndarray]:
    """Meshes in all eight labellings, whose sigmas are `stated` (x, y, z) times what their Gaussian errors have."""
    rng = np.random.default_rng(0)
    truth = (SQUARE.flat() + 0.1 * rng.normal(size=(meshes, 32, 32, 3))).astype(np.float32)
    std = rng.uniform(0.01, 0.03, truth.shape).astype(np.float32)
    mean = truth + std * rng.normal(size=truth.shape).astype(np.float32)
    k = np.arange(meshes) % 8
    relabelled = (relabel_batch(part, k) for part in (mean, std * np.array(stated, np.float32)))
    return ProbabilisticMesh(*relabelled), truth


@pytest.mark.parametrize("factor", [1.0, 0.5])
def test_gaussian_errors_are_covered_as_the_normal_distribution_says(factor: float) -> None:
    curve = calibration.curve(np.asarray(deviations(*noisy((factor,) * 3))))
    assert set(curve["axis"]) == {"all", "xy", "z"}
    np.testing.assert_allclose(curve["expected"], normal_coverage(curve["z"]), atol=1e-9)
    # 32,768 coordinates at least: three standard deviations of a share are 0.009 at most.
    np.testing.assert_allclose(curve["coverage"], normal_coverage(curve["z"], factor), atol=0.009)


def test_axes_are_told_apart() -> None:
    curve = calibration.curve(np.asarray(deviations(*noisy((1, 1, 2)))))
    for axis, factor in (("xy", 1), ("z", 2)):
        own = curve[curve["axis"] == axis]
        np.testing.assert_allclose(own["coverage"], normal_coverage(own["z"], factor), atol=0.009)
    shares = curve.pivot(index="z", columns="axis", values="coverage")
    np.testing.assert_allclose(shares["all"], (2 * shares["xy"] + shares["z"]) / 3, atol=1e-9)


def test_an_error_of_just_z_sigma_is_not_below_it() -> None:
    curve = calibration.curve(np.full((1, 2, 2, 3), 1.0)).query("axis == 'all'").set_index("z")["coverage"]
    assert curve[1.0] == 0
    assert curve[1.1] == 1


def test_rows_count_the_states_that_there_are() -> None:
    rng = np.random.default_rng(0)
    vertices = (SQUARE.flat() + 0.1 * rng.normal(size=(2, 4, 32, 32, 3))).astype(np.float32)
    manipulation = rng.uniform(-1, 1, (2, 3, 6)).astype(np.float32)
    # The second sequence, of the test split, ends after two manipulations.
    vertices[1, 3] = manipulation[1, 2] = np.nan
    dataset = Dataset(
        vertices,
        np.zeros((2, 4, 2), np.float32),
        manipulation,
        np.full((2, 3), 2, np.int8),
        np.array([3, 2], np.int8),
        np.array([0, 2], np.int8),
        np.ones(2, bool),
        *papers_cloths(2),
    )
    config = PEMDConfig(latent=4, encoder=(8,), manipulation=6, decoder=(8,))
    net = Net(config, pemd.initial(config, key=jax.random.key(0)))
    given = Starts(np.arange(2), {"main": vertices, "a1": vertices})
    estimates = {"sequence": np.arange(2), "mean": vertices + np.float32(0.0145), "std": np.full_like(vertices, 0.01)}
    tidy = calibration.rows(dataset, given, net, estimates, EvaluatePredictionConfig(batch=2))
    assert list(tidy) == ["split", "system", "length", "axis", "z", "expected", "coverage"]
    assert not tidy.isna().any(axis=None)
    assert not tidy.duplicated(["split", "system", "length", "axis", "z"]).any()
    lengths = tidy.groupby(["split", "system"])["length"].unique().map(sorted).to_dict()
    assert lengths == {
        (split, system): [1, 2, 3][:count]
        for split, count in (("train", 3), ("test", 2))
        for system in ("main", "a1", "estimate")
    }
    # Estimates that are off by 1.45 sigma throughout.
    of_estimates = tidy[tidy["system"] == "estimate"]
    np.testing.assert_array_equal(of_estimates["coverage"], (of_estimates["z"] > 1.45).astype(float))
    # Two manipulations of the test sequence: from its first state alone.
    predicted, _ = predicted_by(net, vertices[1:, 0], manipulation[1:, :2])
    final = ProbabilisticMesh(*(np.asarray(part)[-1] for part in predicted))
    by_hand = calibration.curve(np.asarray(deviations(final, vertices[1:, 2])))
    found = tidy.query("split == 'test' and system == 'main' and length == 2")
    np.testing.assert_allclose(found["coverage"], by_hand["coverage"], atol=2e-3)
