"""The named fabrics: their params, and that the solver folds them."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE
from clothkit.simulation.attempts import attempt_sequences
from clothkit.simulation.executor import execute
from clothkit.simulation.material import FABRICS, Material
from clothkit.simulation.settings import Limits, Settling, SimulateConfig, SimulationConfig
from clothkit.simulation.world import Motion, Worlds

ADAPTER = TypeAdapter(SimulationConfig)
ONE_STEP = Limits(height=1e-3)
"""No fold is that low: sequences end with their first."""


def test_a_fabric_is_named_in_params() -> None:
    assert ADAPTER.validate_python({"material": "towel"}, strict=False).material == FABRICS["towel"]
    assert ADAPTER.validate_python({"material": {"density": 0.1}}, strict=False).material == Material(density=0.1)
    with pytest.raises(ValidationError, match=r"no fabric 'wool'; there are jersey, stiff_cotton, towel"):
        ADAPTER.validate_python({"material": "wool"}, strict=False)


def test_what_is_recorded_of_a_fabric_are_its_numbers() -> None:
    recorded = ADAPTER.dump_python(ADAPTER.validate_python({"material": "jersey"}, strict=False), mode="json")[
        "material"
    ]
    assert recorded["density"] == 0.187
    assert recorded["shear_stiffness"] == 20.0


@pytest.mark.parametrize("fabric", FABRICS)
def test_fabrics_fold_without_flaws(fabric: str) -> None:
    simulation = replace(SimulationConfig(), material=FABRICS[fabric])
    config = SimulateConfig(sequences=1, simulation=simulation, limits=ONE_STEP)
    attempts = attempt_sequences(range(2), config)
    assert (attempts.reached > 1).all()
    assert (attempts.intersections[:, 1] == 0).all()
    assert (attempts.gap[:, 1] > simulation.material.thickness / 2).all()
    assert (attempts.strain_p99[:, 1] < 0.03).all()
    assert (attempts.residual_speed[:, 1] < 0.01).all()


@pytest.mark.parametrize("fabric", FABRICS)
def test_fabrics_do_not_creep(fabric: str) -> None:
    """A random fold, watched for three more seconds."""
    simulation = replace(SimulationConfig(), material=FABRICS[fabric])
    config = SimulateConfig(sequences=1, simulation=simulation, limits=ONE_STEP)
    folded = attempt_sequences(range(1), config).states[:, 1]
    watching = replace(simulation, settling=Settling(rest_time=3.0, longest=3.5))
    nothing = Motion(np.full((1, 2, 1), -1), np.zeros((1, 2, 2, 3)), np.array([1e-3]))
    watched = Worlds(1, watching).execute(folded, nothing)
    assert np.linalg.norm(watched.states - folded, axis=-1).max() < 2e-3


def test_stiffer_cotton_stands_higher() -> None:
    """What is four times as stiff and less than twice as heavy bends around a wider edge, here of a half fold."""
    corners = SQUARE.flat()[[[0, 0]], [[0, -1]], :2]
    heights = []
    for fabric in ("jersey", "stiff_cotton"):
        settings = replace(SimulationConfig(), material=FABRICS[fabric])
        move, single = np.array([[CLOTH_LENGTH, 0.0]]), np.zeros(1, bool)
        heights.append(execute(SQUARE.flat()[None], corners, move, single, settings=settings, workers=1)[..., 2].max())
    assert heights[1] > 1.02 * heights[0]
