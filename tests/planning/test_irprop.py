"""iRprop- against the published pseudo-code (Igel and Hüsken, 2000), written as a loop over single weights."""

import jax.numpy as jnp
import numpy as np
import pydantic
import pytest

from clothkit.planning.irprop import IRpropConfig, irprop_minus


def published(weights: list[float], slopes: list[list[float]]) -> list[float]:
    """The algorithm as printed, for gradients that are given in advance; returns the weights after all steps."""
    weights = list(weights)
    delta, before = [0.05] * len(weights), [0.0] * len(weights)
    for gradient in slopes:
        for i, g in enumerate(gradient):
            if before[i] * g > 0:
                delta[i] = min(delta[i] * 1.2, 0.05)
            elif before[i] * g < 0:
                delta[i] = max(delta[i] * 0.5, 1e-3)
                g = 0.0
            sign = (g > 0) - (g < 0)
            weights[i] = weights[i] - sign * delta[i]
            before[i] = g
    return weights


def test_follows_the_published_algorithm() -> None:
    rng = np.random.default_rng(0)
    slopes = rng.normal(size=(60, 20)) * 10.0 ** rng.integers(-30, 20, (60, 20))
    slopes[rng.random(slopes.shape) < 0.1] = 0
    start = rng.normal(size=20)
    settings = IRpropConfig()
    weights, before, rate = jnp.asarray(start, jnp.float32), jnp.zeros(20), jnp.full(20, settings.initial)
    for gradient in slopes.astype(np.float32):
        update, before, rate = irprop_minus(jnp.asarray(gradient), before, rate, settings)
        weights = weights + update
    np.testing.assert_allclose(weights, published(start.tolist(), slopes.tolist()), atol=1e-5)


def test_the_first_update_acts_on_the_gradient_at_hand() -> None:
    settings = IRpropConfig()
    update, _, _ = irprop_minus(jnp.array([2.0, -3.0, 0.0]), jnp.zeros(3), jnp.full(3, settings.initial), settings)
    np.testing.assert_allclose(update, [-0.05, 0.05, 0])


@pytest.mark.parametrize("wrong", [{"initial": 0.1}, {"most": 0.01}, {"least": 0.06}])
def test_the_first_step_size_lies_between_its_bounds(wrong: dict[str, float]) -> None:
    with pytest.raises(pydantic.ValidationError, match="initial must be at least"):
        IRpropConfig(**wrong)
