"""Eqs. (13) to (15) against NumPy, for two nets and for others, and a gradient that survives any difference."""

import dataclasses
from itertools import combinations
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from clothkit.cloth.mesh import ProbabilisticMesh, whiten
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.objective import (
    Likelihood,
    Outlook,
    Range,
    Reference,
    Uncertainty,
    Weights,
    evaluate,
    fix,
    objective_of,
)
from clothkit.planning.types import Candidates, Problem
from clothkit.planning.uncertainty import LARGEST_EXPONENT, Spread, bounded_exp, uncertainty
from tests.planning import toy


def meshes(seed: int, *batch: int) -> tuple[np.ndarray, ProbabilisticMesh]:
    rng = np.random.default_rng(seed)
    shape = (*batch, 32, 32, 3)
    goal, mean = rng.normal(0, 0.3, (2, *shape)).astype(np.float32)
    return goal, ProbabilisticMesh(jnp.asarray(mean), jnp.asarray(rng.uniform(0.02, 0.2, shape).astype(np.float32)))


def whitened(mean: np.ndarray, std: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    spread = mean.std((0, 1))
    return (mean - mean.mean((0, 1))) / spread, std / spread


def test_accuracy_term() -> None:
    goal, outcome = meshes(0)
    mean, std = whitened(np.asarray(outcome.mean, float), np.asarray(outcome.std, float))
    goal_white, _ = whitened(goal.astype(float), goal)
    nll = -norm.logpdf(goal_white, mean, std).mean()
    loss = MESH.accuracy(whiten(goal), outcome)
    np.testing.assert_allclose(loss, nll, rtol=1e-4)
    term = Likelihood((Range(np.zeros(1), np.ones(1)), Range(np.float32([0, -0.5]), np.float32([9, 2.5]))))
    np.testing.assert_allclose(term.in_range(loss, 1), (nll + 0.5) / 3, rtol=1e-4)
    np.testing.assert_allclose(Likelihood(()).in_range(loss, 0), nll, rtol=1e-4)


def test_accuracy_of_each_is_accuracy_for_each() -> None:
    goals = whiten(meshes(3, 5)[0])
    _, outcomes = meshes(4, 2)
    found = MESH.accuracy_of_each(goals, outcomes)
    expected = [[MESH.accuracy(g, ProbabilisticMesh(m, s)) for g in goals] for m, s in zip(*outcomes, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_uncertainty() -> None:
    a, b = (
        ProbabilisticMesh(*(jnp.stack(p) for p in zip(meshes(s)[1], meshes(s + 9)[1], strict=True))) for s in (1, 2)
    )
    spread = Spread(jnp.array([1.7, 2.0]), jnp.array([0.4, 0.5]))
    expected = 0.0
    for i in range(2):
        six = [np.concatenate(whitened(np.asarray(p.mean[i]), np.asarray(p.std[i])), axis=-1) for p in (a, b)]
        difference = ((six[0] - six[1]) ** 2).mean()
        np.testing.assert_allclose(MESH.difference(a, b)[i], difference, rtol=1e-4)
        expected += np.exp(5 * ((difference - spread.mean[i]) / spread.std[i] - 1.25)) / 2
    np.testing.assert_allclose(uncertainty(MESH.difference(a, b), spread, beta=5, gamma=1.25), expected, rtol=1e-3)


def test_the_exponential_goes_on_as_its_tangent() -> None:
    x = jnp.array([-3.0, 0.0, LARGEST_EXPONENT - 1e-3, LARGEST_EXPONENT + 1, 1e25])
    slope = jax.vmap(jax.grad(bounded_exp))(x)
    np.testing.assert_allclose(bounded_exp(x[:3]), np.exp(x[:3]), rtol=1e-5)
    np.testing.assert_allclose(bounded_exp(x[3]), 2 * np.exp(LARGEST_EXPONENT), rtol=1e-5)
    assert np.isfinite(bounded_exp(x)).all()
    assert (np.isfinite(slope) & (slope > 0)).all()


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e3, 1e6])
def test_gradients_are_finite_however_much_the_nets_differ(scale: float) -> None:
    _, a = meshes(3)
    _, b = meshes(4)
    spread = Spread(jnp.array([0.1]), jnp.array([1e-3]))

    def u(factor: jax.Array) -> jax.Array:
        other = ProbabilisticMesh(b.mean * factor, b.std * factor**2)
        return uncertainty(MESH.difference(a, other)[None], spread, beta=5, gamma=1.25)

    value, slope = jax.value_and_grad(u)(jnp.float32(scale))
    assert np.isfinite(value)
    assert np.isfinite(slope)
    if scale > 1:
        assert slope > 0


def test_a_flat_goal_has_a_finite_loss() -> None:
    goal = np.zeros((32, 32, 3), np.float32)
    goal[..., :2] = np.random.default_rng(0).normal(size=(32, 32, 2))
    _, outcome = meshes(5)
    value, slope = jax.value_and_grad(lambda m: MESH.accuracy(whiten(goal), ProbabilisticMesh(m, outcome.std)))(
        outcome.mean
    )
    assert np.isfinite(value)
    assert np.isfinite(slope).all()


STRENGTHS = (1.0, 1.03, 0.9, 1.2, 1.1)


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_the_objective_of_any_number_of_nets_by_hand(count: int) -> None:
    """Accuracy terms times 2 / K, u from the mean difference over all pairs; for two nets this is eq. (13)."""
    mesh, plan = toy.bent(), np.array([[-1.0, 0.5, 1.0, 0.2, 0.3, 0.6], [0.1, 0.5, 0.1, 0.5, -0.6, 0.2]], np.float32)
    goal = toy.bent() * np.float32([0.9, 1.1, 1])
    nets = tuple(jnp.float32(strength) for strength in STRENGTHS[:count])
    spans = tuple(Range(np.float32([9, -1 - 0.1 * net]), np.float32([10, 1 + net])) for net in range(count))
    spread = Spread(np.float32([0.01, 0.02]), np.float32([0.05, 0.04]))
    objective = objective_of(count, Reference(spans, spread), Weights(0.25, 5.0, 1.25))
    traces = tuple(np.zeros((8, 3072), np.float32) for _ in nets)
    none = Candidates(np.zeros((1, 2), np.float32), 0)
    asked = Problem(mesh, goal, none, traces, np.int32(0), np.bool_(False), plan)
    zero = jnp.zeros(1, jnp.int32)
    found = evaluate(
        objective, toy.MODEL, MESH, nets, fix(toy.MODEL, MESH, nets, asked), jnp.asarray(plan)[None], zero, zero
    )
    states = []
    for net in nets:
        first = toy.dragged(jnp.asarray(mesh), jnp.asarray(plan[0]), net)
        second = toy.dragged(first, jnp.asarray(plan[1]), net * 1.02)
        states.append([ProbabilisticMesh(m, jnp.full_like(m, 0.015)) for m in (first, second)])
    six = [[np.concatenate(whitened(np.asarray(m.mean), np.asarray(m.std)), -1) for m in of_net] for of_net in states]
    losses = []
    for net, of_net in enumerate(states):
        mean, std = whitened(np.asarray(of_net[1].mean, float), np.asarray(of_net[1].std, float))
        losses.append(-norm.logpdf(whitened(goal.astype(float), goal)[0], mean, std).mean())
        if count > 1:
            losses[-1] = (losses[-1] + 1 + 0.1 * net) / (2 + 1.1 * net)
    np.testing.assert_allclose(found.terms["accuracy"][0], losses, rtol=1e-3)
    if count == 1:
        assert list(found.terms) == ["accuracy"]
        np.testing.assert_allclose(found.loss[0], losses[0], rtol=1e-3)
        return
    apart = [np.mean([((a[i] - b[i]) ** 2).mean() for a, b in combinations(six, 2)]) for i in range(2)]
    u = np.mean(np.exp(5 * ((np.array(apart) - spread.mean) / spread.std - 1.25)))
    np.testing.assert_allclose(found.terms["uncertainty"][0], u, rtol=1e-3)
    np.testing.assert_allclose(found.loss[0], 2 / count * sum(losses) + 0.25 * u, rtol=1e-3)


def test_without_alpha_there_is_no_uncertainty_term() -> None:
    reference = toy.NORMALISATION.reference(2)
    assert list(objective_of(2, reference, toy.WEIGHTS).terms) == ["uncertainty"]
    assert objective_of(2, reference, toy.WEIGHTS._replace(alpha=0.0)).terms == {}


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Effort:
    """The length of all displacements: a term that this package does not have."""

    weight: float
    every_step: ClassVar[bool] = False

    def __call__(self, outlook: Outlook) -> jax.Array:
        return jnp.linalg.norm(outlook.plan[..., 4:], axis=-1).sum(-1)


def test_a_term_from_outside_is_added_with_its_weight() -> None:
    plan = jnp.array([[[-1.0, 0.5, 1.0, 0.2, 0.3, 0.4]]])
    reference, mesh, zero = toy.NORMALISATION.reference(1), toy.bent(), jnp.zeros(1, jnp.int32)
    traces = tuple(np.zeros((8, 3072), np.float32) for _ in toy.NETS)
    none = Candidates(np.zeros((1, 2), np.float32), 0)
    asked = Problem(mesh, mesh, none, traces, np.int32(0), np.bool_(False), np.zeros((1, 6), np.float32))
    fixed = fix(toy.MODEL, MESH, toy.NETS, asked)
    usual = objective_of(2, reference, toy.WEIGHTS)
    plain, more = (
        evaluate(objective, toy.MODEL, MESH, toy.NETS, fixed, plan, zero, zero)
        for objective in (usual, usual.with_term("effort", Effort(3.0)))
    )
    np.testing.assert_allclose(more.terms["effort"], [0.5], rtol=1e-6)
    np.testing.assert_allclose(more.loss, plain.loss + 1.5, rtol=1e-5)
    assert isinstance(usual.terms["uncertainty"], Uncertainty)


def test_a_planner_adds_its_further_terms_to_those_of_the_paper() -> None:
    effort = Effort(3.0)
    planner = dataclasses.replace(toy.planner("main"), terms={"effort": effort})
    assert list(planner.objective(1).terms) == ["uncertainty", "effort"]
    assert planner.objective(1).terms["effort"] is effort
    certain = dataclasses.replace(planner, weights=toy.WEIGHTS._replace(alpha=0.0))
    assert certain.objective(1).terms == {"effort": effort}
    assert list(toy.planner("main").objective(1).terms) == ["uncertainty"]
