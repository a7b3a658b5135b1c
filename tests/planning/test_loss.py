"""Eqs. (13) to (15) against NumPy, and a gradient that survives any difference."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from clothkit.planning.loss import (
    LARGEST_EXPONENT,
    Range,
    Spread,
    accuracy,
    accuracy_of_each,
    bounded_exp,
    diff,
    uncertainty,
)
from scipy.stats import norm

from clothkit.cloth.mesh import ProbabilisticMesh, whiten


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
    np.testing.assert_allclose(accuracy(whiten(goal), outcome), nll, rtol=1e-4)
    span = Range(-0.5, 2.5)
    np.testing.assert_allclose(accuracy(whiten(goal), outcome, span), (nll + 0.5) / 3, rtol=1e-4)


def test_accuracy_of_each_is_accuracy_for_each() -> None:
    goals = whiten(meshes(3, 5)[0])
    _, outcomes = meshes(4, 2)
    found = accuracy_of_each(goals, outcomes, Range(-0.5, 2.5))
    expected = [
        [accuracy(g, ProbabilisticMesh(m, s), Range(-0.5, 2.5)) for g in goals] for m, s in zip(*outcomes, strict=True)
    ]
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
        np.testing.assert_allclose(diff(a, b)[i], difference, rtol=1e-4)
        expected += np.exp(5 * ((difference - spread.mean[i]) / spread.std[i] - 1.25)) / 2
    np.testing.assert_allclose(uncertainty(diff(a, b), spread, beta=5, gamma=1.25), expected, rtol=1e-3)


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
        return uncertainty(diff(a, other)[None], spread, beta=5, gamma=1.25)

    value, slope = jax.value_and_grad(u)(jnp.float32(scale))
    assert np.isfinite(value)
    assert np.isfinite(slope)
    if scale > 1:
        assert slope > 0


def test_a_flat_goal_has_a_finite_loss() -> None:
    goal = np.zeros((32, 32, 3), np.float32)
    goal[..., :2] = np.random.default_rng(0).normal(size=(32, 32, 2))
    _, outcome = meshes(5)
    value, slope = jax.value_and_grad(lambda m: accuracy(whiten(goal), ProbabilisticMesh(m, outcome.std)))(outcome.mean)
    assert np.isfinite(value)
    assert np.isfinite(slope).all()
