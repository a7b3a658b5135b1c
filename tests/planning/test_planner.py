"""Planners from artifacts: which weight the uncertainty term has for each system."""

from dataclasses import replace
from pathlib import Path

import pytest

from clothkit.manipulation.candidates import CandidateConfig
from clothkit.planning.model_error import ModelError
from clothkit.planning.objective import Uncertainty, Weights
from clothkit.planning.planner import Planner, assemble
from clothkit.planning.settings import PlanConfig
from clothkit.planning.systems import SYSTEMS
from clothkit.planning.uncertainty_terms import Measure, UncertaintyConfig
from tests.tiny import MEMBERS, write_nets


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("planner") / "data"
    write_nets(folder)
    return folder


def planner(data: Path, name: str, measure: Measure, alpha: float) -> Planner:
    settings = replace(PlanConfig(), uncertainty=UncertaintyConfig(measure=measure, u_weight=0.02))
    return assemble(SYSTEMS[name], data, Weights(alpha, 5.0, 1.25), settings, CandidateConfig(), MEMBERS)


@pytest.mark.parametrize(
    ("name", "measure", "kind", "weight"),
    [
        ("main", "expected", ModelError, 0.5),
        ("main", "paper", Uncertainty, 0.01),
        # Systems that plan in voxels have the paper's measure, whatever is chosen for meshes.
        ("b4", "expected", Uncertainty, 0.01),
        ("b4", "paper", Uncertainty, 0.01),
    ],
)
def test_alpha_weighs_an_error_as_it_is_and_u_by_its_own_weight(
    data: Path, name: str, measure: Measure, kind: type, weight: float
) -> None:
    for alpha in (0.5, 1.0):
        term = planner(data, name, measure, alpha).objective(2).terms["uncertainty"]
        assert isinstance(term, kind)
        assert float(term.weight) == pytest.approx(2 * alpha * weight)
    assert "uncertainty" not in planner(data, name, measure, 0.0).objective(2).terms


def test_systems_without_doubt_have_no_term(data: Path) -> None:
    for name in ("b2", "b3", "b5"):
        assert "uncertainty" not in planner(data, name, "expected", 1.0).objective(2).terms
