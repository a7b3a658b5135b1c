"""Optimisers by name: in settings files, on the command line, and from outside the package."""

import dataclasses
import json
from collections.abc import Iterator

import jax
import pydantic
import pytest
from jaxtyping import Array

from clothkit.planning.irprop import IRpropConfig
from clothkit.planning.optimisers import OPTIMISERS, AnySettings, evaluations, optimise, optimiser, register
from clothkit.planning.optimisers.cem import CEMConfig
from clothkit.planning.optimisers.gradient import GradientConfig
from clothkit.planning.optimisers.hybrid import HybridConfig
from clothkit.planning.optimisers.population import evaluate_in_chunks
from clothkit.planning.optimisers.space import Evaluate, Initial, Outcome, Space
from clothkit.runtime.config import config
from clothkit.runtime.errors import InputError
from tests.planning.optimisers import bowl


@config
class Stage:
    """A stage's settings."""

    search: AnySettings = GradientConfig()


ADAPTER = pydantic.TypeAdapter(Stage)


def read(text: str) -> Stage:
    return ADAPTER.validate_json(text, strict=True)


@config
class FirstConfig:
    """Settings of an optimiser that somebody else wrote."""

    plans: int = 10

    @property
    def finalists(self) -> int:
        return self.plans

    def evaluations(self, length: int) -> int:
        return self.plans

    def shape(self, length: int) -> tuple[int, int]:
        return 1, self.plans


def first(
    evaluate: Evaluate, space: Space, settings: FirstConfig, *, initial: Initial | None = None, key: Array
) -> Outcome:
    """The best of the first plans that come to mind."""
    tried = evaluate_in_chunks(evaluate, space, space.sample(settings.plans, key=key), settings.plans)
    return Outcome(tried, tried.loss[None])


@pytest.fixture
def registered() -> Iterator[None]:
    register("first", FirstConfig, first)
    yield
    del OPTIMISERS["first"]


def test_all_have_defaults() -> None:
    for name, each in OPTIMISERS.items():
        settings = optimiser(name).settings()
        assert evaluations(settings, 3) > settings.finalists
        assert hash(settings) == hash(each.settings())


def test_settings_name_their_optimiser() -> None:
    assert read("{}").search == GradientConfig()
    assert read('{"search": {"strains": 64}}').search == GradientConfig(strains=64)
    got = read('{"search": {"name": "cem", "iterations": 3}}').search
    assert got == CEMConfig(iterations=3)
    phases = '[{"name": "cem", "iterations": 2}, {"strains": 8, "irprop": {"initial": 0.01}}]'
    hybrid = read(f'{{"search": {{"name": "hybrid", "phases": {phases}}}}}')
    assert isinstance(hybrid.search, HybridConfig)
    assert hybrid.search.phases[0] == CEMConfig(iterations=2)
    assert hybrid.search.phases[1] == GradientConfig(strains=8, irprop=IRpropConfig(initial=0.01))
    # What is written is read as the same.
    written = ADAPTER.dump_python(hybrid, mode="json")
    assert written["search"]["phases"][1]["name"] == "gradient"
    assert read(json.dumps(written)) == hybrid
    assert hash(hybrid) == hash(read(json.dumps(written)))
    assert dataclasses.replace(Stage(), search=CEMConfig()).search == CEMConfig()


@pytest.mark.parametrize(
    ("text", "where", "what"),
    [
        ('{"search": {"name": "cem", "strains": 3}}', ("search", "strains"), "unexpected"),
        ('{"search": {"name": "cem", "plans": "3"}}', ("search", "plans"), "integer"),
        ('{"search": {"name": "sgd"}}', ("search",), "expected one of gradient, random_shooting, cem"),
        ('{"search": 3}', ("search",), "expected the settings of an optimiser"),
        ('{"search": {"name": "hybrid", "phases": [{"near": 2.0}]}}', ("search", "phases", 0, "near"), "less"),
        ('{"search": {"name": ["cem"]}}', ("search",), "expected one of gradient"),
    ],
)
def test_errors_name_the_setting(text: str, where: tuple, what: str) -> None:
    with pytest.raises(pydantic.ValidationError, match=what) as caught:
        read(text)
    assert caught.value.errors()[0]["loc"] == where


@pytest.mark.usefixtures("registered")
def test_one_from_outside() -> None:
    settings = read('{"search": {"name": "first", "plans": 20}}').search
    assert settings == FirstConfig(plans=20)
    found = optimise(bowl.objective(1), bowl.space(1), settings, key=jax.random.key(0))
    assert found.loss == found.losses.min()
    assert found.losses.shape == (1, 20)
    assert evaluations(settings, 1) == 40
    with pytest.raises(ValueError, match="its own"):
        register("first", CEMConfig, first)
    with pytest.raises(ValueError, match="its own"):
        register("second", FirstConfig, first)


def test_names_that_there_are_not() -> None:
    with pytest.raises(
        InputError, match="expected one of gradient, random_shooting, cem, mppi, greedy, hybrid, found 'adam'"
    ):
        optimiser("adam")
    with pytest.raises(InputError, match="FirstConfig"):
        optimise(bowl.objective(1), bowl.space(1), FirstConfig(), key=jax.random.key(0))
