"""Settings beyond those in which the solver was tried are refused, by name and in one sentence."""

import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from clothkit.cloth.topology import Topology, rectangle, square
from clothkit.params import load_params
from clothkit.runtime.errors import InputError
from clothkit.simulation.settings import LEAST_SPACING, SimulateConfig, SimulationConfig
from tests.test_params import write

ADAPTER = TypeAdapter(SimulateConfig)
ABSURD: list[tuple[str, object]] = [
    ("simulation.side", 3),
    ("simulation.side", 7),  # the kernels' sort by height needs more room than so few vertices have
    ("simulation.side", 200),
    ("simulation.cloth_side", 1e-6),
    ("simulation.cloth_side", 0.02),
    ("simulation.cloth_side", 100.0),
    ("simulation.time_step", 1e-9),
    ("simulation.time_step", 10.0),
    ("simulation.hand_speed", 1e-3),
    ("simulation.hand_speed", 1e3),
    ("simulation.shortest_move", 1e-9),
    ("simulation.shortest_move", 1e9),
    ("simulation.highest_lift", 1e6),
    ("simulation.top_speed", 1e-6),
    ("simulation.push_speed", 1e9),
    ("simulation.settling.interval", 1e-9),
    ("simulation.settling.longest", 1e9),
    ("simulation.settling.rest_time", 1e9),
    ("simulation.settling.rest_speed", 1e-12),
    ("simulation.guard.interval", 1e-9),
    ("simulation.guard.care", 1e-12),
    ("simulation.guard.tries", 10**6),
    ("simulation.guard.passes", 10**6),
    ("simulation.material.density", 1e-30),
    ("simulation.material.stretch_stiffness", 1e30),
    ("simulation.material.bending_stiffness", 1e30),
    ("simulation.material.thickness", 1e-9),
    ("simulation.material.thickness", 1.0),
    ("simulation.material.viscosity", 1e9),
    ("simulation.material.drag", 1e9),
    ("sampling.tries", 10**9),
    ("sampling.reach", 1e9),
    ("sampling.fold_point", 1e-9),
    ("candidates.resolution", 10**6),
    ("candidates.extent", 1e9),
    ("candidates.most", 10**9),
    ("candidates.block", 1e9),
    ("candidates.radius", 1e9),
    ("candidates.spacing", 1e9),
    ("block", 10**9),
    ("workers", 10**6),
    ("sequences", 10**9),
]
DISAGREEING: list[tuple[dict[str, Any], str]] = [
    ({"side": 64, "cloth_side": 0.1}, "cloth_side / (side - 1), the distance of neighbouring vertices, is 0.0016 m"),
    ({"side": 64, "cloth_side": 0.4, "material": {"thickness": 5e-3}}, "expected at least 0.0075 m"),
    ({"hand_speed": 0.6, "top_speed": 0.5}, "hand_speed is 0.6 m/s, expected at most top_speed, 0.5 m/s"),
    ({"top_speed": 0.3}, "hand_speed is 0.42 m/s, expected at most top_speed, 0.3 m/s"),
]


@pytest.mark.parametrize(("field", "value"), ABSURD, ids=[f"{field}={value:g}" for field, value in ABSURD])  # type: ignore[str-format]
def test_absurd_settings_are_refused_by_name(field: str, value: object) -> None:
    *path, last = field.split(".")
    given: dict[str, Any] = {last: value}
    for name in reversed(path):
        given = {name: given}
    with pytest.raises(ValidationError) as told:
        ADAPTER.validate_json(json.dumps({"sequences": 1, **given}))
    assert [error["loc"] for error in told.value.errors()] == [tuple(field.split("."))]


@pytest.mark.parametrize(("changes", "says"), DISAGREEING)
def test_settings_that_do_not_agree_are_refused(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ValidationError, match="1 validation error") as told:
        ADAPTER.validate_json(json.dumps({"sequences": 1, "simulation": changes}))
    assert says in told.value.errors()[0]["msg"]


def test_they_are_told_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError) as told:
        load_params(write(tmp_path, **{"scales.smoke.simulate.simulation.time_step": 10.0}))
    path, field, says = str(told.value).split(": ")
    assert path.endswith("params.yaml")
    assert field == "scales.smoke.simulate.simulation.time_step"
    assert says == "input should be less than or equal to 0.002, found 10.0"
    with pytest.raises(InputError) as told:
        load_params(write(tmp_path, **{"scales.smoke.simulate.simulation.top_speed": 0.3}))
    assert "scales.smoke.simulate.simulation: " in str(told.value)
    assert "no vertex follows a faster hand" in str(told.value)


def test_the_finest_grid_is_told_by_the_thickness() -> None:
    config = SimulationConfig(side=63)
    assert min(config.spacing(config.topology)) / config.material.thickness > LEAST_SPACING


@pytest.mark.parametrize(
    ("topology", "told"),
    [
        (square(65), "65 x 65 vertices, expected 8 to 64"),
        (rectangle(1.5, shape=(32, 7)), "32 x 7 vertices, expected 8 to 64"),
        (rectangle(3.0, shape=(32, 64)), "is 0.0021 m, expected at least 0.003 m"),
    ],
)
def test_cloths_that_the_solver_can_not_simulate_are_refused(topology: Topology, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        SimulationConfig().check(topology)


def test_spacings_are_those_of_the_longer_side() -> None:
    config = SimulationConfig(cloth_side=0.5)
    assert config.spacing(rectangle(0.5 / 0.3, shape=(32, 24))) == pytest.approx((0.5 / 31, 0.3 / 23))
    assert config.spacing(rectangle(0.3 / 0.5)) == pytest.approx((0.3 / 31, 0.5 / 31))
