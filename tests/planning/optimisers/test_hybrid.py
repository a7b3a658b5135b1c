"""Several optimisers in turn: a phase begins with the best plans of the one before."""

import jax
import numpy as np
from jaxtyping import Array

from clothkit.planning.optimisers.gradient import GradientConfig
from clothkit.planning.optimisers.hybrid import HybridConfig, in_turn
from clothkit.planning.optimisers.random_shooting import RandomShootingConfig
from clothkit.planning.optimisers.space import Outcome, Settings
from tests.planning.optimisers import bowl

SHOOTING = RandomShootingConfig(plans=60, chunk=20, finalists=12)


def run(*phases: Settings) -> Outcome:
    def search(key: Array) -> Outcome:
        return in_turn(bowl.objective(2), bowl.space(2), HybridConfig(phases=phases), key=key)

    return bowl.as_arrays(jax.jit(search)(jax.random.key(0)))


def test_a_phase_begins_with_the_finalists_of_the_one_before() -> None:
    """The first of them, if it has fewer strains; beside random plans, if it has more."""
    for strains in (8, 16):
        descent = GradientConfig(strains=strains, base_iterations=3, iterations_per_step=0)
        found = run(SHOOTING, descent)
        assert found.losses.shape == (3 + 3, 20)
        finalists = np.sort(found.losses[:3].ravel())[:12]
        given = min(strains, 12)
        np.testing.assert_allclose(found.losses[3, :given], finalists[:given], rtol=1e-6)
        assert (found.losses[3, given:strains] > finalists[0]).all()
        assert np.isinf(found.losses[3:, strains:]).all()
        assert found.best.loss.shape == (strains,)
        assert found.best.loss.min() <= finalists[0]


def test_a_smaller_phase_gets_the_best_of_a_gradient_search() -> None:
    """Whose strains are in no order."""
    first, last = (GradientConfig(strains=n, base_iterations=4, iterations_per_step=0) for n in (16, 4))
    found = run(first, last)
    np.testing.assert_allclose(found.losses[4, :4], np.sort(found.losses[:4].min(0))[:4], rtol=1e-6)


def test_evaluations_are_those_of_all_phases() -> None:
    descent = GradientConfig(strains=8, base_iterations=3, iterations_per_step=2)
    settings = HybridConfig(phases=(SHOOTING, descent))
    assert settings.evaluations(2) == 60 + 8 * 7
    assert settings.finalists == 8
