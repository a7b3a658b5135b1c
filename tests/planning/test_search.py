"""The search finds manipulations that are known, whatever the labels of estimate and goal."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from clothkit.cloth.mesh import ProbabilisticMesh, error, nll, whiten, whiten_probabilistic
from clothkit.cloth.silhouette import pixel_centres
from clothkit.cloth.symmetry import equal_labellings, equivalents, relabel, relabel_manipulation
from clothkit.cloth.topology import SQUARE
from clothkit.manipulation.geometry import release_points, to_cartesian
from clothkit.manipulation.vector import is_null, is_single
from clothkit.planning.initial import EXTENT, FOLD_POINT, RASTER
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.objective import Fixed, Likelihood, Objective, Range, Weights, evaluate, objective_of
from clothkit.planning.search import SearchConfig, carried_plans, search
from clothkit.planning.types import UNKNOWN, Candidates, Found, Problem
from clothkit.planning.uncertainty import uncertainty
from tests.planning import toy

CORNERS = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]], np.float32)
SURE = dataclasses.replace(toy.NORMALISATION, mu=(0.001,) * 3, sigma=(0.001,) * 3)
"""Nets that differ less than the toy's do, as a rule: u is about ten, where it is all but zero otherwise."""
BEST = jnp.array([-1.0, -1.0, -1.0, -1.0, 0.7, 0.4])
ONE_LOOK = {"stride": 1, "base_iterations": 1, "iterations_per_step": 0}
"""Settings of a search that ends where it begins."""


def padded(points: np.ndarray) -> Candidates:
    missing = toy.CANDIDATES.most - len(points)
    return Candidates(np.concatenate([points, np.zeros((missing, 2), np.float32)]), np.int32(len(points)))


def problem(mesh: np.ndarray, goal: np.ndarray, length: int = 1, **changes: object) -> Problem:
    """A first search of a session."""
    fields = {
        "state": mesh,
        "goal": goal,
        "candidates": padded(CORNERS),
        "traces": tuple(np.zeros((SQUARE.count, 3072), np.float32) for _ in toy.NETS),
        "relative": np.int32(UNKNOWN),
        "later": np.bool_(False),
        "carried": np.zeros((length, 6), np.float32),
    }
    return Problem(**{**fields, **changes})


def find(
    *problems: Problem,
    length: int = 1,
    seeds: tuple[int, ...] = (0,),
    size: SearchConfig = toy.SEARCH,
    weights: Weights = toy.WEIGHTS,
) -> Found:
    """What a batch of searches finds; the last problem fills up the batch."""
    missing = toy.BATCH - len(problems)
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *problems, *problems[-1:] * missing)
    keys = jnp.stack([jax.random.key(seed) for seed in (*seeds, *seeds[-1:] * missing)])
    objective = objective_of(2, toy.NORMALISATION.reference(length), weights)
    of = {"length": length, "settings": size, "keys": keys}
    return jax.tree.map(np.asarray, search(toy.MODEL, MESH, toy.NETS, stacked, objective, **of))


def accuracy(goal: jax.Array, outcome: ProbabilisticMesh, span: Range) -> jax.Array:
    """An accuracy term of eq. (13), for a whitened goal."""
    low, high = span.low[-1], span.high[-1]
    return (nll(goal, whiten_probabilistic(outcome)) - low) / (high - low)


def first(found: Found) -> Found:
    return jax.tree.map(lambda leaf: leaf[0], found)


def test_finds_a_known_manipulation() -> None:
    mesh = toy.bent()
    goal = np.asarray(toy.dragged(jnp.asarray(mesh), BEST))
    found = first(find(problem(mesh, goal, relative=np.int32(0), candidates=padded(CORNERS[[0, 3]]))))
    np.testing.assert_allclose(found.plan[0], BEST, atol=0.05)
    assert found.relative == 0
    assert found.losses.shape == (35, 64)
    assert not np.isnan(found.losses).any()


def test_finds_what_the_memory_traces_make_of_a_manipulation() -> None:
    """After ten manipulations vertices follow a hand by 1.2 times as much: another displacement reaches the goal."""
    mesh = toy.bent()
    goal = np.asarray(toy.dragged(jnp.asarray(mesh), BEST * jnp.array([1, 1, 1, 1, 1.2, 1.2])))
    traces = tuple(np.full((SQUARE.count, 3072), 10, np.float32) for _ in toy.NETS)
    asked = problem(mesh, goal, relative=np.int32(0), candidates=padded(CORNERS[[0, 3]]), traces=traces)
    np.testing.assert_allclose(first(find(asked)).plan[0], BEST, atol=0.04)


def test_a_search_for_folds_keeps_the_first_q_on_the_cloth() -> None:
    """The best plan's q is off what is said to be covered: the best of the others is found, and never that one."""
    mesh = toy.bent()
    goal = np.asarray(toy.dragged(jnp.asarray(mesh), BEST))
    corner = padded(CORNERS[:1])
    place = to_cartesian(jnp.asarray(mesh), jnp.asarray(CORNERS[0]))[:2]
    beyond = place + FOLD_POINT * BEST[4:]
    axis = pixel_centres(RASTER, EXTENT)
    covered = np.broadcast_to((axis < beyond[0] - 0.2)[:, None], (RASTER, RASTER))
    size = toy.searching(fold=True, screen=2)
    found = first(find(problem(mesh, goal, relative=np.int32(0), candidates=corner, covered=covered), size=size))
    q = place + FOLD_POINT * found.plan[0, 4:]
    assert q[0] < beyond[0] - 0.2 + 2 * EXTENT / RASTER
    free = first(find(problem(mesh, goal, relative=np.int32(0), candidates=corner)))
    assert found.loss > free.loss
    # As near as it may come: the displacement along x is as long as is allowed, that along y is right.
    assert q[0] > beyond[0] - 0.35
    assert abs(found.plan[0, 5] - BEST[5]) < 0.15


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 7), st.integers(0, 7))
def test_labels_of_estimate_and_goal_do_not_matter(a: int, b: int) -> None:
    """Whatever the labels, executing the plan on the true cloth reaches the goal's shape."""
    truth = toy.bent()
    goal = np.asarray(toy.dragged(jnp.asarray(truth), BEST))
    only = relabel_manipulation(BEST, a)[:2]
    candidates = padded(np.asarray(only)[None])
    asked = problem(np.asarray(relabel(truth, a)), np.asarray(relabel(goal, b)), candidates=candidates)
    found = first(find(asked, seeds=(8 * a + b,)))
    on_the_truth = relabel_manipulation(found.plan[0], SQUARE.inverses[a])
    outcome = toy.dragged(jnp.asarray(truth), on_the_truth)
    assert error(outcome, goal, aligned=True) < 0.02
    assert found.relative == SQUARE.composed[SQUARE.inverses[b], a]


def test_the_loss_is_the_same_in_every_common_equivalent() -> None:
    mesh, plan = toy.bent(), jnp.array([[-1.0, 0.5, 1.0, 0.2, 0.3, 0.5], [0.1, 0.5, 0.1, 0.5, -0.3, 0.2]])
    goal = np.asarray(relabel(toy.dragged(jnp.asarray(mesh), BEST), 3))
    fixed = Fixed(
        tuple(toy.encode(net, equivalents(mesh)) for net in toy.NETS),
        # Net a remembers three manipulations, net b five.
        tuple(jnp.full((SQUARE.count, 3072), count) for count in (3.0, 5.0)),
        equivalents(goal),
        jnp.ones(SQUARE.count, bool),
    )
    labels = jnp.arange(SQUARE.count)
    plans = jnp.stack([relabel_manipulation(plan, k) for k in range(SQUARE.count)])
    reference = SURE.reference(2)
    objective = objective_of(2, reference, toy.WEIGHTS)
    loss_of = jax.jit(lambda *of: evaluate(objective, toy.MODEL, MESH, toy.NETS, fixed, plans, labels, *of))
    loss, terms, _ = loss_of(jnp.full(8, SQUARE.inverses[3]))
    np.testing.assert_allclose(loss, loss[0], rtol=1e-3)
    # Eq. (13), spelled out in the labels of the mesh.
    chains = (_chain(net, mesh, plan, before=count) for net, count in zip(toy.NETS, (3, 5), strict=True))
    states = [toy.decode(toy.NETS[0], chain, 1) for chain in chains]
    outcomes = [jax.tree.map(lambda part: part[-1], state) for state in states]
    aimed = whiten(relabel(goal, SQUARE.inverses[3]))
    scores = [accuracy(aimed, outcome, span) for outcome, span in zip(outcomes, reference.spans, strict=True)]
    u = uncertainty(MESH.difference(*states), reference.spread, beta=5.0, gamma=1.25)
    np.testing.assert_allclose(terms["accuracy"][0], jnp.stack(scores), rtol=1e-3)
    np.testing.assert_allclose(terms["uncertainty"][0], u, rtol=1e-3)
    assert u > 1
    np.testing.assert_allclose(loss[0], sum(scores) + 0.25 * u, rtol=1e-3)
    # A labelling that is not known is that of the least accuracy terms, whatever the common equivalent.
    least = [
        sum(accuracy(whiten(relabel(goal, k)), o, s) for o, s in zip(outcomes, reference.spans, strict=True))
        for k in range(8)
    ]
    best, _, relative = loss_of(jnp.full(8, UNKNOWN))
    assert (relative == int(np.argmin(least))).all()
    np.testing.assert_allclose(best, min(map(float, least)) + 0.25 * u, rtol=1e-3)
    # Of a rectangle, among the labellings that keep its sides.
    keeping = equal_labellings(np.array([1.4, 1.0, 0.007], np.float32))
    of_sides = jax.jit(
        lambda same: evaluate(
            objective, toy.MODEL, MESH, toy.NETS, fixed._replace(same=same), plans, labels, jnp.full(8, UNKNOWN)
        )
    )
    best, _, relative = of_sides(keeping)
    allowed = np.where(keeping, least, np.inf)
    assert np.argmin(allowed) != np.argmin(least)
    assert (relative == int(np.argmin(allowed))).all()
    np.testing.assert_allclose(best, allowed.min() + 0.25 * u, rtol=1e-3)
    # One net plans with the plain NLL.
    one = Fixed(fixed.latents[:1], fixed.traces[:1], fixed.goals, fixed.same)
    plain = objective_of(1, reference, toy.WEIGHTS)
    alone = evaluate(plain, toy.MODEL, MESH, toy.NETS[:1], one, plans, labels, jnp.full(8, SQUARE.inverses[3]))
    np.testing.assert_allclose(alone.loss, nll(aimed, whiten_probabilistic(outcomes[0])), rtol=1e-3)
    assert list(alone.terms) == ["accuracy"]


def test_a_goal_that_is_foreseen_exactly_is_not_missed_by_thinned_vertices_either() -> None:
    """Goals and predictions are whitened by the same vertices: what is left of the loss is that of sigma."""
    mesh, plan = toy.bent(), jnp.array([[-1.0, 0.5, 1.0, 0.2, 0.3, 0.5]])
    net = toy.NETS[:1]
    outcome = jax.tree.map(lambda part: part[0], toy.decode(net[0], _chain(net[0], mesh, plan), 4))
    whole = toy.decode(net[0], _chain(net[0], mesh, plan), 1).mean[0]
    every = jnp.ones(SQUARE.count, bool)
    latents, traces = toy.encode(net[0], equivalents(mesh)), jnp.zeros((SQUARE.count, 3072))
    fixed = Fixed((latents,), (traces,), equivalents(whole), every)
    plain, first = Objective(Likelihood(()), {}), jnp.array([0])
    loss = evaluate(plain, toy.MODEL, MESH, net, fixed, plan[None], first, first, stride=4).loss
    std = np.asarray(outcome.std / jnp.maximum(outcome.mean.std((0, 1)), 0.005))
    np.testing.assert_allclose(loss[0], np.mean(np.log(std)) + np.log(2 * np.pi) / 2, rtol=1e-3)


def _chain(net: jax.Array, mesh: np.ndarray, plan: jax.Array, before: int = 0) -> jax.Array:
    states, state = [], jnp.asarray(mesh)
    for remembered, manipulation in enumerate(plan, start=before):
        state = toy.dragged(state, manipulation, net * (1 + 0.02 * remembered))
        states.append(state.reshape(-1))
    return jnp.stack(states)


def test_later_searches_start_from_what_is_left_of_the_plan() -> None:
    mesh = toy.bent()
    goal = np.asarray(toy.dragged(jnp.asarray(mesh), BEST))
    # Not quite on the candidate: snapping mends it.
    carried = np.asarray(BEST + jnp.array([0.1, 0.1, 0.1, 0.1, 0, 0]))[None]
    warm = first(find(problem(mesh, goal, carried=carried, relative=np.int32(0), later=np.bool_(True))))
    assert warm.losses[0, :8].max() < warm.losses[0, 8:].min()
    np.testing.assert_allclose(warm.plan[0], BEST, atol=0.05)
    assert warm.relative == 0


def test_hands_of_a_first_manipulation_are_never_on_different_sides() -> None:
    mesh = toy.bent()
    # What only hands that part could do.
    goal = np.asarray(mesh * np.float32([1.4, 1, 1]))
    found = find(problem(mesh, goal), problem(mesh, goal), seeds=(0, 1))
    for plan in found.plan:
        grasps = np.stack([np.asarray(to_cartesian(mesh, uv))[:2] for uv in plan[0, :4].reshape(2, 2)])
        assert release_points(grasps, plan[0, 4:]).same_side or is_null(plan[0])


def test_one_hand_stays_one_hand_and_first_grasps_stay_candidates() -> None:
    mesh = toy.bent()
    goal = np.asarray(toy.dragged(toy.dragged(jnp.asarray(mesh), BEST), jnp.array([0.9, 1, 0.9, 1, -0.5, -0.6])))
    found = find(problem(mesh, goal, 2), problem(mesh, goal, 2), length=2, seeds=(0, 1))
    for plan in found.plan:
        for grasp in plan[0, :4].reshape(2, 2):
            assert np.abs(CORNERS - grasp).sum(-1).min() < 1e-6
        assert np.abs(plan[:, :4]).max() <= 1
        apart = np.abs(plan[1, :2] - plan[1, 2:4]).max()
        assert apart == 0 or apart > 1e-3


def test_without_one_handed_manipulations_each_hand_has_a_candidate_of_its_own() -> None:
    mesh = toy.bent()
    goal = np.asarray(toy.dragged(jnp.asarray(mesh), BEST))
    # One hand would do, and both hands of what is left of a plan have the same nearest candidate.
    carried = np.asarray(BEST + jnp.array([0.1, 0, 0, 0.1, 0, 0]))[None]
    asked = problem(mesh, goal, carried=carried, relative=np.int32(0), later=np.bool_(True))
    assert is_single(first(find(asked)).plan[0])
    two = dataclasses.replace(toy.SEARCH, one_handed=0.0)
    found = first(find(asked, size=two))
    assert not is_single(found.plan[0])
    assert np.isfinite(found.loss)
    # Where there is a single point to grasp, one hand grasps it.
    alone = find(asked._replace(candidates=padded(CORNERS[:1])), size=two)
    np.testing.assert_allclose(first(alone).plan[0], BEST, atol=0.05)


def test_screened_strains_start_where_the_loss_is_least() -> None:
    """First losses are the least of so many draws each, far lower than those of single draws; carried plans stay."""
    mesh = toy.bent()
    goal = np.asarray(toy.dragged(jnp.asarray(mesh), BEST))
    plain, screened = (
        first(
            find(
                problem(mesh, goal, relative=np.int32(0)),
                size=toy.searching(**ONE_LOOK, screen=screen),
            )
        )
        for screen in (1, 8)
    )
    assert np.median(screened.losses[0]) < np.quantile(plain.losses[0], 0.25)
    carried = problem(mesh, goal, carried=np.asarray(BEST)[None], relative=np.int32(0), later=np.bool_(True))
    unscreened, warm = (first(find(carried, size=toy.searching(**ONE_LOOK, screen=screen))) for screen in (1, 8))
    np.testing.assert_allclose(warm.losses[0, :8], unscreened.losses[0, :8], rtol=1e-4)
    assert np.median(warm.losses[0, 8:]) < np.median(unscreened.losses[0, 8:])


def test_the_best_plan_is_the_one_that_had_the_lowest_loss() -> None:
    """The plan as it was when its loss was taken, and not as the step after that left it."""
    mesh = toy.bent()
    goal = np.asarray(toy.dragged(jnp.asarray(mesh), BEST))
    found = first(find(problem(mesh, goal, relative=np.int32(0)), size=toy.searching(**ONE_LOOK)))
    np.testing.assert_allclose(found.loss, found.losses.min(), rtol=1e-4)
    after = [toy.dragged(jnp.asarray(mesh), found.plan[0], net) for net in toy.NETS]
    outcomes = [toy.decode(toy.NETS[0], mesh.reshape(-1), 1) for mesh in after]
    spans = toy.NORMALISATION.reference(1).spans
    by_hand = [accuracy(whiten(goal), outcome, span) for outcome, span in zip(outcomes, spans, strict=True)]
    np.testing.assert_allclose(found.terms["accuracy"], by_hand, rtol=1e-3)
    # Eq. (13): alpha weighs u.
    wary = toy.WEIGHTS._replace(gamma=-1.5)
    unsure = first(find(problem(mesh, goal, relative=np.int32(0)), size=toy.searching(**ONE_LOOK), weights=wary))
    (a, b), u = unsure.terms["accuracy"], unsure.terms["uncertainty"]
    assert u > 10
    np.testing.assert_allclose(unsure.loss, a + b + 0.25 * u, rtol=1e-4)
    np.testing.assert_allclose(unsure.loss, unsure.losses.min(), rtol=1e-4)


def test_the_same_key_gives_the_same_plan_beside_any_neighbour() -> None:
    mesh = toy.bent()
    goals = [np.asarray(toy.dragged(jnp.asarray(mesh), jnp.array(m))) for m in ([1.0, 1, 1, 1, -0.6, -0.6], BEST)]
    a, b = (problem(mesh, goal) for goal in goals)
    plans = find(a, b, seeds=(5, 6)).plan
    np.testing.assert_array_equal(plans, find(b, a, seeds=(6, 5)).plan[::-1])
    np.testing.assert_array_equal(plans[1], find(b, b, seeds=(6, 6)).plan[0])


def test_inverse_table() -> None:
    mesh = toy.bent()
    for k in range(SQUARE.count):
        np.testing.assert_array_equal(relabel(relabel(mesh, k), int(SQUARE.inverses[k])), mesh)


def test_a_carried_plan_begins_a_later_search_once_in_each_common_equivalent() -> None:
    mesh = toy.bent()
    plan = np.array([[-1.0, -1.0, -1.0, -1.0, 0.7, 0.4], [0.9, 0.2, -0.3, 0.1, 0.5, -0.6]], np.float32)
    asked = problem(mesh, mesh, 2, carried=plan, later=np.bool_(True), relative=np.int32(3))
    initial = carried_plans(MESH, asked)
    np.testing.assert_array_equal(initial.plans.plan, np.broadcast_to(plan, (SQUARE.count, 2, 6)))
    assert initial.plans.labels[0].tolist() == list(range(SQUARE.count))
    assert initial.plans.labels[1].tolist() == [3] * SQUARE.count
    assert initial.given.all()
    assert not carried_plans(MESH, asked._replace(later=np.bool_(False))).given.any()
