"""The search finds manipulations that are known, whatever the labels of estimate and goal."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clothkit.cloth.equivalents import COUNT, compose, equivalents, inverse, relabel, relabel_manipulation
from clothkit.cloth.mesh import error, whiten
from clothkit.networks.net import Net
from clothkit.networks.pemd import PEMDConfig, decode, initial
from clothkit.planning.draw import Candidates
from clothkit.planning.forward import MESH, decode_thinned
from clothkit.planning.loss import Weights, accuracy, diff, uncertainty
from clothkit.planning.search import DRAWN, INVERSE, Fixed, Found, Problem, SearchConfig, planning_loss, search
from tests.planning import toy

CORNERS = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]], np.float32)
BEST = jnp.array([-1.0, -1.0, -1.0, -1.0, 0.7, 0.4])
FEW = Candidates(np.concatenate([CORNERS[[0, 3]], np.zeros((4, 2), np.float32)]), np.int32(2))
WEIGHTS = Weights(1.0, 5.0, 1.25)
TOY = SearchConfig(strains=64, every=4)


def problem(mesh: np.ndarray, goal: np.ndarray, length: int = 1, **changes: object) -> Problem:
    """A first search of a session, as a batch of one."""
    fields = {
        "mesh": mesh,
        "goal": goal,
        "candidates": Candidates(np.concatenate([CORNERS, np.zeros((2, 2), np.float32)]), np.int32(4)),
        "traces": tuple(np.zeros((COUNT, 3072), np.float32) for _ in toy.NETS),
        "relative": np.int32(DRAWN),
        "later": np.bool_(False),
        "carried": np.zeros((length, 6), np.float32),
    }
    return jax.tree.map(lambda leaf: np.asarray(leaf)[None], Problem(**{**fields, **changes}))


def find(
    asked: Problem, *, length: int = 1, seed: int = 0, config: SearchConfig = TOY, nets: tuple = toy.NETS
) -> Found:
    reference = toy.NORMALISATION.reference(length)
    keys = jax.random.split(jax.random.key(seed), 1)
    asked = asked._replace(traces=asked.traces[: len(nets)])
    ask = partial(search, toy.FORWARD, nets, asked, reference, WEIGHTS, length=length, settings=config, keys=keys)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[0], ask(explicit=True))


@pytest.mark.parametrize("nets", [toy.NETS, toy.NETS[:1]])
def test_finds_a_known_manipulation(nets: tuple) -> None:
    mesh = toy.bent()
    goal = np.asarray(toy.dragged(jnp.asarray(mesh), BEST))
    found = find(problem(mesh, goal, relative=np.int32(0), candidates=FEW), nets=nets)
    np.testing.assert_allclose(found.plan[0], BEST, atol=0.05)
    assert found.relative == 0
    assert found.losses.shape == (50, 64)
    assert found.restarts.any()
    assert np.isfinite(found.losses).all()


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 7), st.integers(0, 7))
def test_labels_of_estimate_and_goal_do_not_matter(a: int, b: int) -> None:
    """Whatever the labels, executing the plan on the true cloth reaches the goal's shape."""
    truth = toy.bent()
    goal = np.asarray(toy.dragged(jnp.asarray(truth), BEST))
    only = relabel_manipulation(BEST, a)[:2]
    candidates = Candidates(np.zeros((6, 2), np.float32) + np.asarray(only), np.int32(1))
    asked = problem(np.asarray(relabel(truth, a)), np.asarray(relabel(goal, b)), candidates=candidates)
    found = find(asked, seed=8 * a + b)
    on_the_truth = relabel_manipulation(found.plan[0], inverse(a))
    outcome = toy.dragged(jnp.asarray(truth), on_the_truth)
    assert error(outcome, goal, aligned=True) < 0.02
    assert found.relative == compose(inverse(b), a)


def test_the_loss_is_the_same_in_every_common_equivalent() -> None:
    mesh, plan = toy.bent(), jnp.array([[-1.0, 0.5, 1.0, 0.2, 0.3, 0.5], [0.1, 0.5, 0.1, 0.5, -0.3, 0.2]])
    goal = np.asarray(relabel(toy.dragged(jnp.asarray(mesh), BEST), 3))
    fixed = Fixed(
        tuple(toy.encode(net, equivalents(mesh)) for net in toy.NETS),
        tuple(jnp.zeros((COUNT, 3072)) for _ in toy.NETS),
        whiten(equivalents(goal)),
    )
    labels = jnp.arange(COUNT)
    plans = jnp.stack([relabel_manipulation(plan, k) for k in range(COUNT)])
    reference = toy.NORMALISATION.reference(2)
    loss, terms = planning_loss(
        toy.FORWARD, toy.NETS, fixed, reference, WEIGHTS, plans, labels, jnp.full(8, inverse(3)), explicit=True
    )
    np.testing.assert_allclose(loss, loss[0], rtol=1e-3)
    # Eq. (13), spelled out in the labels of the mesh.
    states = [toy.decode(net, _chain(net, mesh, plan), 1) for net in toy.NETS]
    outcomes = [jax.tree.map(lambda part: part[-1], state) for state in states]
    aimed = whiten(relabel(goal, inverse(3)))
    scores = [accuracy(aimed, outcome, span) for outcome, span in zip(outcomes, reference.spans, strict=True)]
    u = uncertainty(diff(*states), reference.spread, beta=5.0, gamma=1.25)
    np.testing.assert_allclose(terms[0], jnp.stack([*scores, u]), rtol=1e-3)
    np.testing.assert_allclose(loss[0], sum(scores) + u, rtol=1e-3)


def _chain(net: jax.Array, mesh: np.ndarray, plan: jax.Array) -> jax.Array:
    states, state = [], jnp.asarray(mesh)
    for manipulation in plan:
        state = toy.dragged(state, manipulation, net)
        states.append(state.reshape(-1))
    return jnp.stack(states)


def test_later_searches_start_from_what_is_left_of_the_plan() -> None:
    mesh = toy.bent()
    goal = np.asarray(toy.dragged(jnp.asarray(mesh), BEST))
    # Not quite on the candidate: snapping mends it.
    carried = np.asarray(BEST + jnp.array([0.1, 0.1, 0.1, 0.1, 0, 0]))[None]
    warm = find(problem(mesh, goal, carried=carried, relative=np.int32(0), later=np.bool_(True)))
    np.testing.assert_allclose(warm.losses[0, :8], warm.losses[0, 0], rtol=1e-3)
    assert warm.losses[0, 0] < warm.losses[0, 8:].min()
    np.testing.assert_allclose(warm.plan[0], BEST, atol=0.05)
    assert warm.relative == 0


def test_one_hand_stays_one_hand_and_first_grasps_stay_candidates() -> None:
    mesh = toy.bent()
    goal = np.asarray(toy.dragged(toy.dragged(jnp.asarray(mesh), BEST), jnp.array([0.9, 1, 0.9, 1, -0.5, -0.6])))
    singles = 0
    for seed in range(4):
        config = dataclasses.replace(TOY, strains=8, base_iterations=5, iterations_per_step=5)
        plan = find(problem(mesh, goal, 2), length=2, seed=seed, config=config).plan
        for grasp in plan[0, :4].reshape(2, 2):
            assert np.abs(CORNERS - grasp).sum(-1).min() < 1e-6
        assert np.abs(plan[:, :4]).max() <= 1
        apart = np.abs(plan[1, :2] - plan[1, 2:4]).max()
        singles += apart == 0
        assert apart == 0 or apart > 1e-4
    assert 0 <= singles <= 4


def test_the_same_key_gives_the_same_plan_beside_any_neighbour() -> None:
    mesh = toy.bent()
    goals = [np.asarray(toy.dragged(jnp.asarray(mesh), jnp.array(m))) for m in ([1.0, 1, 1, 1, -0.6, -0.6], BEST)]
    asked = [problem(mesh, goal) for goal in goals]
    keys = jax.random.split(jax.random.key(5), 2)

    def both(order: list[int]) -> Found:
        joined = jax.tree.map(lambda *leaves: np.concatenate(leaves), *(asked[i] for i in order))
        reference = toy.NORMALISATION.reference(1)
        return search(
            toy.FORWARD,
            toy.NETS,
            joined,
            reference,
            WEIGHTS,
            length=1,
            settings=TOY,
            explicit=True,
            keys=keys[jnp.array(order)],
        )

    plans = both([0, 1]).plan
    np.testing.assert_array_equal(plans, both([1, 0]).plan[::-1])
    np.testing.assert_array_equal(plans[1], both([1, 1]).plan[0])


def test_inverse_table() -> None:
    mesh = toy.bent()
    for k in range(COUNT):
        np.testing.assert_array_equal(relabel(relabel(mesh, k), int(INVERSE[k])), mesh)


def test_thinned_decoding_is_the_decoder_at_these_vertices() -> None:
    config = PEMDConfig(latent=4, encoder=(8,), manipulation=8, decoder=(8, 12))
    net = Net(config, initial(config, key=jax.random.key(0)))
    latent = jax.random.normal(jax.random.key(1), (3, 2, 4))
    full, thin = decode(net, latent), decode_thinned(net, latent, 2)
    np.testing.assert_allclose(thin.mean, full.mean[..., ::2, ::2, :], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(thin.std, full.std[..., ::2, ::2, :], rtol=1e-5)
    assert MESH.decode is decode_thinned
