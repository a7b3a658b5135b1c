"""Measures of uncertainty by name: which terms a planner gets, and that they say what a formula by hand says."""

from itertools import product
from pathlib import Path
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.models import support_model
from clothkit.models.settings import SupportModelConfig
from clothkit.models.support_model import SupportModel
from clothkit.planning import error_map, uncertainty_terms
from clothkit.planning.conditional import Conditional
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.model_error import LEAST, SIGNS, ModelError, Surprise
from clothkit.planning.objective import Distance, Evaluation, Objective, Outlook, evaluate, fix
from clothkit.planning.types import UNKNOWN, Candidates, Problem
from clothkit.planning.uncertainty_terms import EXPECTED_ERROR, SUPPORT, Measure, UncertaintyConfig, terms_of
from clothkit.runtime.errors import InputError
from tests import tiny
from tests.planning import toy

PLANS = np.array(
    [
        [[-1, -1, -1, -1, 0.6, 0.5], [1, 1, 1, 1, -0.7, -0.3]],
        [[-1, 1, -1, 1, 0.9, 0.2], [0.2, 0.1, 0.2, 0.1, 0.4, -0.8]],
    ],
    np.float32,
)
MAP = ErrorMap(
    SIGNS, np.array(LEAST), np.array([0.1, 0.2, 0.3]), np.array([0.9, 0.4, 0.3]), np.ones(1), np.ones((1, 3))
)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a support model and a map of errors."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "nets").mkdir()
    (folder / "normalisation").mkdir()
    shown = np.random.default_rng(0).normal(size=(4, 3078)).astype(np.float32)
    support = support_model.initial(SupportModelConfig(hidden=(8,)), shown, jax.random.key(0))
    support_model.save(folder / SUPPORT, support)
    error_map.save(folder / EXPECTED_ERROR, MAP, {})
    return folder


def chosen(measure: Measure, data: Path, alpha: float = 1.0) -> tuple[Any, Any]:
    return terms_of(UncertaintyConfig(measure=measure), alpha, toy.Nets(), data)


def test_the_papers_measure_adds_nothing_and_without_alpha_nothing_is_doubted(data: Path) -> None:
    assert chosen("paper", data) == (None, {})
    for measure in uncertainty_terms.MEASURES:
        assert not chosen(measure, data, alpha=0)[1]
    assert isinstance(chosen("expected", data, alpha=0)[0], Distance)
    assert isinstance(chosen("conditional", data)[1]["uncertainty"], Conditional)
    assert isinstance(chosen("support", data)[1]["uncertainty"], Surprise)


class OneNet(toy.Nets):
    """The toy's first net alone."""

    @property
    def params(self) -> tuple[Any, ...]:
        return super().params[:1]


def test_one_net_alone_is_doubted_for_what_was_never_recorded(data: Path) -> None:
    """It has none to differ from: by the support of its data alone."""
    for measure in uncertainty_terms.MEASURES:
        _, terms = terms_of(UncertaintyConfig(measure=measure), 1.0, OneNet(), data)
        assert bool(terms) == (measure == "support")
    _, terms = terms_of(UncertaintyConfig(measure="support"), 1.0, OneNet(), data)
    objective = toy.planner("b2").objective(2).with_term("uncertainty", terms["uncertainty"])
    support = support_model.load(data / SUPPORT, width=3078)
    expected = surprises(support, outcomes()[0][0]).mean(0)
    np.testing.assert_allclose(evaluated(objective).terms["uncertainty"], expected, rtol=2e-3)


def test_what_is_missing_is_told(tmp_path: Path) -> None:
    assert chosen("conditional", tmp_path)[1]
    with pytest.raises(InputError, match=r"support\.npz"):
        chosen("expected", tmp_path)


def evaluated(objective: Objective) -> Evaluation:
    state = toy.bent()
    goal = np.asarray(toy.dragged(jnp.asarray(state), jnp.asarray(PLANS[0, 0])))
    candidates = Candidates(jnp.zeros((4, 2)), jnp.int32(4))
    traces = (jnp.zeros((8, 3072)),) * 2
    problem = Problem(state, goal, candidates, traces, jnp.int32(0), jnp.asarray(False), np.zeros((2, 6), np.float32))
    fixed = fix(toy.MODEL, MESH, toy.NETS, problem)
    first = jnp.zeros(2, int)
    return evaluate(objective, toy.MODEL, MESH, toy.NETS, fixed, jnp.asarray(PLANS), first, first + UNKNOWN)


def outcomes() -> tuple[list[list[np.ndarray]], np.ndarray]:
    """Each net's predicted states by plan [2 3 u v 3], and the goal."""
    found = []
    for net in toy.NETS:
        state, latents = np.broadcast_to(toy.bent().reshape(1, -1), (2, 3072)), []
        trace = jnp.zeros((2, 3072))
        for step in range(2):
            latents.append(np.asarray(state).reshape(2, 32, 32, 3))
            state, trace, _ = toy.step(net, jnp.asarray(state), trace, jnp.asarray(PLANS[:, step]))
        found.append([*latents, np.asarray(state).reshape(2, 32, 32, 3)])
    return found, np.asarray(toy.dragged(jnp.asarray(toy.bent()), jnp.asarray(PLANS[0, 0])))


def surprises(support: SupportModel, states: list[np.ndarray]) -> np.ndarray:
    """By hand [step plan]."""
    found = []
    for step in range(2):
        units = np.concatenate([states[step].reshape(2, -1), PLANS[:, step]], axis=1)
        units = (units - support.mean) / support.std
        hidden, last = support.layers
        units = units @ hidden.weights + hidden.bias
        units = units / (1 + np.exp(-units))
        found.append(np.log1p(np.exp(-(units @ last.weights + last.bias)[:, 0])))
    return np.array(found)


def smooth(mesh: np.ndarray, target: np.ndarray) -> np.ndarray:
    """By hand: the mean distance of aligned vertices, each at least a thousandth, in lengths of a cloth of 1.4."""
    apart = mesh - target
    apart = apart - apart.mean(axis=(-3, -2), keepdims=True)
    return np.sqrt((apart**2).sum(-1) + 1e-3**2).mean(axis=(-2, -1)) / 1.4


def test_the_objective_is_the_distance_of_the_predicted_outcome_and_its_expected_error(data: Path) -> None:
    accuracy, terms = chosen("expected", data, alpha=0.5)
    found = evaluated(Objective(accuracy, terms))
    predicted, goal = outcomes()
    support = support_model.load(data / SUPPORT, width=3078)
    by_nets = [smooth(states[-1], goal) for states in predicted]
    apart = smooth(predicted[0][-1], predicted[1][-1])
    sigma = np.sqrt(3 * 0.015**2) / 1.4
    signs = np.stack([apart, np.full(2, sigma), surprises(support, predicted[0]).sum(0)]) + np.array(LEAST)[:, None]
    expected = np.exp(0.2) * np.prod(signs ** np.array([[0.9], [0.4], [0.3]]), axis=0)
    np.testing.assert_allclose(found.terms["uncertainty"], expected, rtol=2e-3)
    np.testing.assert_allclose(found.loss, np.mean(by_nets, axis=0) + 0.5 * expected, rtol=2e-3)


HOUSEHOLD = error_map.load(tiny.ROOT / "prebuilt/household" / EXPECTED_ERROR, SIGNS)


@pytest.mark.parametrize("error", [MAP, HOUSEHOLD], ids=["made up", "household"])
def test_the_expected_error_has_a_finite_gradient_however_far_nets_are_apart(error: ErrorMap) -> None:
    """Up to five cloth lengths, in float32, against the slopes of the product of powers by hand."""
    mesh = jnp.asarray(toy.bent())[None, None]
    # Every other row of vertices lies one cloth length (1.4) to one side, the others as far to the other side.
    apart = jnp.zeros((32, 32, 3)).at[:, :, 0].set(1.4 * (-1.0) ** jnp.arange(32)[:, None])
    plan = jnp.zeros((1, 2, 6))

    def value(signs: jax.Array) -> jax.Array:
        distance, sigma, surprise = signs
        std = jnp.broadcast_to(sigma * 1.4 / 3**0.5, mesh.shape)
        states = ProbabilisticMesh(mesh, std), ProbabilisticMesh(mesh + distance * apart, std)
        # The mean over the two manipulations.
        surprises = mock.Mock(spec=Surprise, side_effect=lambda outlook: jnp.full(1, surprise / 2))
        return jnp.sum(ModelError(1.0, error, surprises)(Outlook(MESH, plan, states)))

    signs = np.array(list(product([0, 1e-4, 1e-3, 0.05, 1, 5], [1e-4, 0.02, 1], [0, 1, 50])), np.float32)
    found, slopes = jax.jit(jax.vmap(jax.value_and_grad(value)))(jnp.asarray(signs))
    assert np.isfinite(found).all()
    assert np.isfinite(slopes).all()
    exact = signs.astype(np.float64)
    least_distance = 1e-3 / 1.4
    smooth_distance = np.sqrt(exact[:, 0] ** 2 + least_distance**2)
    units = np.stack([smooth_distance, exact[:, 1], exact[:, 2]], axis=1) + np.asarray(error.least)
    expected = np.exp(error.offset[1]) * np.prod(units ** np.asarray(error.slope), axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-3)
    by_hand = expected[:, None] * np.asarray(error.slope) / units
    by_hand[:, 0] *= exact[:, 0] / smooth_distance
    np.testing.assert_allclose(slopes, by_hand, rtol=5e-3, atol=1e-4)


def test_surprise_is_the_mean_over_manipulations(data: Path) -> None:
    _, terms = chosen("support", data)
    objective = toy.planner("b3").objective(2).with_term("uncertainty", terms["uncertainty"])
    support = support_model.load(data / SUPPORT, width=3078)
    expected = surprises(support, outcomes()[0][0]).mean(0)
    np.testing.assert_allclose(evaluated(objective).terms["uncertainty"], expected, rtol=2e-3)


def test_a_goal_that_is_foreseen_has_a_finite_gradient(data: Path) -> None:
    accuracy, _ = chosen("expected", data)
    mesh = jnp.asarray(toy.bent())
    mesh_of_goal = mesh[None]

    def value(mesh: jax.Array) -> jax.Array:
        return jnp.sum(accuracy.of(MESH, mesh_of_goal, ProbabilisticMesh(mesh[None], mesh[None]), 0, -1))

    assert np.isfinite(jax.grad(value)(mesh)).all()
