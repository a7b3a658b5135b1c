"""Recalibration of VtM's standard deviations: what it finds, and what it changes in a net."""

import numpy as np
import pytest

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.models.settings import VtMConfig
from clothkit.models.vtm import recalibrated
from clothkit.training import recalibration


def drawn(seed: int, factor: float, power: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of a net whose true standard deviations are factor x stated ** power, the stated ones, the states."""
    rng = np.random.default_rng(seed)
    state = np.repeat([1, 2, 3], 40)
    std = np.array([0.01, 0.05, 0.1])[state - 1, None, None, None] * rng.uniform(0.5, 2, (120, 8, 8, 3))
    return np.abs(rng.normal(size=std.shape)) * factor * std**power, std, state


@pytest.mark.parametrize(("factor", "power"), [(1.0, 1.0), (1.6, 1.2), (0.5, 0.9)])
def test_it_finds_how_true_deviations_depend_on_stated_ones(factor: float, power: float) -> None:
    found = recalibration.fit(*drawn(0, factor, power))
    assert found[0] == pytest.approx(factor, rel=0.1)
    assert found[1] == pytest.approx(power, abs=0.03)


def test_ratios_are_ideal_on_other_meshes() -> None:
    factor, power = recalibration.fit(*drawn(0, 1.6, 1.2))
    error, std, state = drawn(1, 1.6, 1.2)
    mesh = recalibrated(ProbabilisticMesh(error, std), VtMConfig(sigma_factor=factor, sigma_power=power))
    ratio = (error / np.asarray(mesh.std)).mean(axis=(1, 2, 3))
    for k in (1, 2, 3):
        assert np.median(ratio[state == k]) == pytest.approx(np.sqrt(2 / np.pi), abs=0.03)


def test_a_net_that_is_not_recalibrated_keeps_its_deviations() -> None:
    mesh = ProbabilisticMesh(np.zeros((4, 4, 3)), np.full((4, 4, 3), 0.02))
    assert recalibrated(mesh, VtMConfig()) is mesh
