"""Doubt conditional on the state: medians by hand, and plans on a state's support."""

from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.manipulation.vector import is_null
from clothkit.planning.conditional import LEAST_DIFFERENCE, NORMAL, Conditional
from clothkit.planning.initial import FOLD_POINT
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.objective import Objective, Outlook, PosedTerm
from clothkit.planning.support import supported_plans
from clothkit.planning.types import Candidates, Problem
from tests.planning import toy


def outlook(differences: np.ndarray | jax.Array) -> Outlook:
    """Plans whose predictions differ by these numbers [n strains]."""
    representation = mock.Mock(difference=lambda a, b: jnp.asarray(differences))
    return Outlook(representation, jnp.zeros((differences.shape[1], len(differences), 6)), (None, None))


def test_z_is_in_deviations_of_plans_on_the_support() -> None:
    drawn = np.exp(np.array([[1.0, 2, 3, 4, 5], [0, 0, 0, 0, 0]])) - LEAST_DIFFERENCE
    term = Conditional(1.0, 2.0).posed(outlook(drawn))
    np.testing.assert_allclose(term.median, [3, 0], atol=1e-5)
    # The median of 2 1 0 1 2 is 1; a spread of zero is raised.
    np.testing.assert_allclose(term.spread, [NORMAL, 0.1], rtol=1e-4)
    others = outlook(np.exp(np.array([[3.0, 6], [0, 1]])) - LEAST_DIFFERENCE)
    np.testing.assert_allclose(term.deviations(others), [[0, 3 / NORMAL], [0, 10]], atol=1e-3)
    expected = np.log1p(np.exp(np.array([[0, 3 / NORMAL], [0, 10]]) - 2.0)).mean(0)
    np.testing.assert_allclose(term(others), expected, rtol=1e-3)


def test_the_penalty_has_a_bounded_slope() -> None:
    """In z: of a plan of two manipulations each counts half, and never more, however far beyond what is usual."""
    drawn = np.exp(np.array([[1.0, 2, 3, 4, 5], [0, 1, 2, 3, 4]])) - LEAST_DIFFERENCE
    term = Conditional(1.0, 2.0).posed(outlook(drawn))

    def value(z: jax.Array) -> jax.Array:
        logarithms = term.median[:, None] + term.spread[:, None] * z
        return jnp.sum(term(outlook(jnp.exp(logarithms) - LEAST_DIFFERENCE)))

    slope = np.asarray(jax.grad(value)(jnp.array([[-5.0, 0, 2, 10, 40], [-5.0, 0, 2, 10, 30]])))
    assert (slope >= 0).all()
    assert (slope <= 0.5 + 1e-5).all()
    np.testing.assert_allclose(slope[:, 2], 0.25, rtol=1e-3)
    np.testing.assert_allclose(slope[:, 4], 0.5, rtol=1e-3)


def test_only_terms_that_are_posed_ask_for_plans() -> None:
    term = Conditional(1.0, 2.0)
    assert isinstance(term, PosedTerm)
    usual = toy.planner("main").objective(1)
    assert usual.draws == 0
    with_it: Objective = usual.with_term("doubt", term)
    assert with_it.draws == 64
    posed = with_it.posed(outlook(np.ones((1, 4))))
    assert posed.terms["uncertainty"] is with_it.terms["uncertainty"]
    assert posed.terms["doubt"].median is not None  # type: ignore[attr-defined]


def test_plans_on_the_support_fold_onto_the_cloth() -> None:
    state = toy.bent()
    found = MESH.candidates(state, toy.CANDIDATES)
    candidates = Candidates(jnp.asarray(np.resize(found, (8, 2))), jnp.int32(len(found)))
    trace = (jnp.zeros((8, 3072)),) * 2
    problem = Problem(
        jnp.asarray(state), state, candidates, trace, jnp.int32(0), jnp.asarray(False), np.zeros((2, 6)),
        covered=jnp.asarray(MESH.covered(state)),
    )  # fmt: skip
    plans = np.asarray(
        supported_plans(toy.MODEL, MESH, toy.NETS[0], problem, count=50, length=2, key=jax.random.key(0))
    )
    assert plans.shape == (50, 2, 6)
    assert not np.asarray(is_null(plans[:, 1])).any()
    # Later hands grasp at the edge, and q of the second manipulation is on a vertex that the net predicts, where the
    # displacement was not too short for it.
    np.testing.assert_allclose(np.abs(plans[:, 1, :4].reshape(-1, 2)).max(1), 1)
    latent, _, _ = toy.step(toy.NETS[0], jnp.tile(state.reshape(1, -1), (50, 1)), trace[0][:1], plans[:, 0])
    predicted: ProbabilisticMesh = toy.decode(toy.NETS[0], latent)
    grasps = np.asarray(jax.vmap(MESH.points)(predicted.mean, plans[:, 1, :4].reshape(-1, 2, 2)))
    q = grasps.mean(1) + FOLD_POINT * plans[:, 1, 4:]
    away = np.linalg.norm(np.asarray(predicted.mean).reshape(50, -1, 3)[..., :2] - q[:, None], axis=-1).min(1)
    long = np.linalg.norm(plans[:, 1, 4:], axis=1) > 0.5
    assert long.sum() > 20
    np.testing.assert_allclose(away[long], 0, atol=1e-3)
