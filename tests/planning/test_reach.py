"""Limits of hands against other computations of the same, and searches in the toy world that keep to them."""

from itertools import permutations
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.symmetry import equivalents, relabel_manipulation_batch
from clothkit.cloth.topology import SQUARE, thinned
from clothkit.manipulation.geometry import arc, to_cartesian
from clothkit.manipulation.vector import is_null
from clothkit.observation.pose import Pose
from clothkit.observation.waypoints import MotionConfig, hand_paths
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.objective import Evaluation, Outlook, evaluate, fix, objective_of
from clothkit.planning.reach import (
    Ball,
    Box,
    Limits,
    Situation,
    breaches,
    graspable,
    hands_of,
    in_zone,
    on_cloth,
    out_of_reach,
    terms_of,
    too_close,
    waypoints,
)
from clothkit.planning.search import search
from clothkit.planning.voxel_representation import VOXEL
from tests.planning import toy
from tests.planning.test_search import problem

SCALE = 0.4 / 1.4
CENTRE = np.array([0.3, -0.1])
MOTION = MotionConfig(waypoints=9)
SHARE = np.linspace(0, 1, MOTION.waypoints)
PROGRESS = SHARE**2 * (3 - 2 * SHARE)
MESH_0 = toy.bent()
SITUATION = Situation(np.asarray(equivalents(MESH_0)), CENTRE, SCALE, PROGRESS, MOTION.highest_lift)
numbers = st.floats(-2, 2, width=32)
points = arrays(np.float32, 3, elements=numbers).map(lambda p: p.astype(float))


@given(points, points, points)
def test_distances_from_a_box_are_those_to_its_nearest_point(
    point: np.ndarray, one: np.ndarray, other: np.ndarray
) -> None:
    low, high = np.minimum(one, other), np.maximum(one, other)
    found = float(Box(low, high).outside(point))
    inside = bool(((low <= point) & (point <= high)).all())
    assert inside == (found <= 0)
    expected = np.linalg.norm(point - np.clip(point, low, high))
    if inside:
        expected = -min((point - low).min(), (high - point).min())
    assert found == pytest.approx(expected, abs=1e-9)
    assert float(Box(low, high).outside(jnp.asarray(point))) == pytest.approx(expected, abs=1e-5)


def test_distances_from_a_ball() -> None:
    ball = Ball((1.0, 2.0, 2.0), 1.0)
    np.testing.assert_allclose(ball.outside(np.zeros(3)), 2.0)
    np.testing.assert_allclose(ball.outside(np.array([[1.0, 2.0, 2.5], [1.0, 2.0, 2.0]])), [-0.5, -1.0])


@given(arrays(np.float64, (2, 4, 3), elements=numbers), st.booleans(), st.floats(0, 0.3))
def test_hands_take_the_regions_in_the_better_order(path: np.ndarray, single: bool, margin: float) -> None:
    regions = (Box((-1.0, -1.0, -1.0), (0.0, 0.5, 1.0)), Ball((0.5, 0.0, 0.0), 0.7))
    away, change = out_of_reach(regions, path, np.array(single), margin)
    hands, best = (0,) if single else (0, 1), []
    for order in permutations((0, 1)):
        each = [max(0.0, *(float(regions[order[h]].outside(p)) + margin for p in path[h])) for h in hands]
        best.append(sum(each))
    assert away.sum() == pytest.approx(min(best), abs=1e-9)
    assert best[int(change)] == pytest.approx(min(best), abs=1e-9)
    assert away[1] == 0 or not single
    # Each way back is possible: of two equal regions, both orders are.
    assert out_of_reach(regions[:1], path, np.array(single), margin)[0].sum() == pytest.approx(
        sum(max(0.0, *(float(regions[0].outside(p)) + margin for p in path[h])) for h in hands), abs=1e-9
    )


@given(arrays(np.float64, (2, 4, 3), elements=numbers), st.floats(0, 0.3))
def test_zones_and_distances_between_hands(path: np.ndarray, margin: float) -> None:
    zone, one, two = Ball((0.0, 0.0, 0.0), 1.0), np.array(True), np.array(False)
    deep = [max(0.0, *(1 + margin - np.linalg.norm(p) for p in hand)) for hand in path]
    np.testing.assert_allclose(in_zone(zone, path, two, margin), deep, atol=1e-9)
    np.testing.assert_allclose(in_zone(zone, path, one, margin), [deep[0], 0], atol=1e-9)
    nearest = min(np.linalg.norm(a - b) for a, b in zip(*path, strict=True))
    assert float(too_close(1.5, path, two, margin)) == pytest.approx(max(0.0, 1.5 + margin - nearest), abs=1e-9)
    assert float(too_close(1.5, path, one, margin)) == 0


def test_points_on_thinned_cloth_are_those_on_the_whole_where_it_is_even() -> None:
    rng = np.random.default_rng(0)
    uv = jnp.asarray(rng.uniform(-1, 1, (5, 2, 2)).astype(np.float32)).at[0].set(jnp.array([[-1, 1], [1, -1]]))
    meshes = np.repeat(MESH_0[None], 5, axis=0)
    whole = np.stack([np.stack([to_cartesian(mesh, p) for p in pair]) for mesh, pair in zip(meshes, uv, strict=True)])
    np.testing.assert_allclose(on_cloth(jnp.asarray(meshes), uv), whole, atol=1e-6)
    even = (SQUARE.flat() @ rng.normal(size=(3, 3)).astype(np.float32)) + np.float32([0.1, 0.2, 0.3])
    for stride in (2, 4, 8):
        kept = jnp.asarray(np.repeat(thinned(even, stride)[None], 5, axis=0))
        expected = np.stack([np.stack([to_cartesian(even, p) for p in pair]) for pair in uv])
        np.testing.assert_allclose(on_cloth(kept, uv), expected, atol=2e-6)


PLANS = np.array(
    [
        [[-1, -1, 1, -1, 0.1, 0.7], [0.5, 1, 0.5, 1, -0.6, -0.4]],
        [[-1, 1, -1, 1, 0.9, -0.2], [0.3, -0.9, -0.2, 0.8, 0.7, 0.1]],
        [[1, 1, 1, 1, 0.1, -0.2], [1, -1, 1, 1, -0.9, 0.1]],
    ],
    np.float32,
)
COMMON = np.array([0, 3, 6], np.int32)


@jax.jit
def evaluated(plans: jax.Array, margin: jax.Array | float) -> Evaluation:
    """The toy nets' evaluation of plans of two manipulations, with the terms of all limits."""
    asked = problem(MESH_0, MESH_0, 2)
    objective = objective_of(2, toy.NORMALISATION.reference(2), toy.WEIGHTS)
    for name, term in terms_of(LIMITS, SITUATION, weight=10.0, net=0, margin=margin).items():
        objective = objective.with_term(name, term)
    own = relabel_manipulation_batch(plans, COMMON)
    zero = jnp.zeros(len(COMMON), jnp.int32)
    fixed = fix(toy.MODEL, MESH, toy.NETS, asked)
    return evaluate(objective, toy.MODEL, MESH, toy.NETS, fixed, own, jnp.asarray(COMMON), zero)


def outlook_of(plans: np.ndarray, mesh: np.ndarray, shifts: np.ndarray, representation: Any = MESH) -> Outlook:
    """What the toy's first net predicts of plans from a mesh, in the labels of the state."""
    means = []
    for step in range(plans.shape[1]):
        before = jnp.asarray(np.repeat(mesh[None], len(plans), axis=0)) if not step else means[-1]
        means.append(toy.dragged(before, jnp.asarray(plans[:, step]), 1 + toy.REMEMBERED * step))
    predicted = ProbabilisticMesh(jnp.stack(means), jnp.ones_like(jnp.stack(means)))
    common = jnp.zeros(len(plans), jnp.int32)
    return Outlook(representation, jnp.asarray(plans), (predicted,), shifts=(jnp.asarray(shifts),), common=common)


def paths_of(plan: np.ndarray) -> list[np.ndarray]:
    """The hands' paths by the functions that make plan files; the toy's centre shift is u1 v1, by its first net."""
    pose, mesh, found = Pose(np.eye(3), np.zeros(3), CENTRE, SCALE), MESH_0, []
    for number, manipulation in enumerate(plan):
        found.append(hand_paths(manipulation, mesh, pose, MOTION).points)
        mesh = np.asarray(toy.dragged(jnp.asarray(mesh), jnp.asarray(manipulation), 1 + toy.REMEMBERED * number))
        pose = pose.moved(manipulation[:2])
    return found


def test_hands_are_where_plan_files_have_them() -> None:
    """At the grasp, along the arc, at the release, and in later steps where the cloth is expected to be."""
    found = waypoints(SITUATION, outlook_of(PLANS, MESH_0, np.moveaxis(PLANS[..., :2], 1, 0)), 0)
    for row, plan in enumerate(PLANS):
        for step, expected in enumerate(paths_of(plan)):
            for hand, points in enumerate(expected):
                np.testing.assert_allclose(found[step, row, hand], points, atol=2e-6)


def test_an_arc_by_hand() -> None:
    """A half fold of a flat cloth: from x = 0.2 m to x = -0.2 m, 0.2 normalised higher, on a circle through both."""
    outlook = outlook_of(
        np.array([[[1, -1, 1, 1, -1.4, 0]]], np.float32), SQUARE.flat(), np.zeros((1, 1, 2), np.float32)
    )
    height = 0.2 * SCALE
    radius = (0.4**2 + height**2) / 0.8
    middle = CENTRE[0] + 0.2 - radius
    flat = SITUATION._replace(states=np.asarray(equivalents(SQUARE.flat())), progress=np.linspace(0, 1, 101))
    for limit, expected in (
        (Box((-9, -9, -9), (9, 9, 0.05)), 2 * (radius - 0.05)),
        (Box((CENTRE[0] - 0.1, -9, -9), (9, 9, 9)), 2 * 0.1),
        (Ball((middle, CENTRE[1], 0.0), 0.1), 2 * (np.hypot(radius, 0.2) - 0.1)),
    ):
        term = terms_of(Limits(hands=(limit,)), flat, weight=1.0, net=0, margin=0.0)["out_of_reach"]
        assert float(term(outlook)[0]) == pytest.approx(expected, abs=2e-4)
    path = arc(np.array([0.7, 0.0, 0.0]), np.array([-0.7, 0.0]))
    assert float(path.radius) * SCALE == pytest.approx(radius)


LIMITS = Limits(
    hands=(Box((0.1, -0.3, -0.1), (0.5, 0.0, 0.06)), Ball((0.2, 0.0, 0.0), 0.25)),
    keep_out=(Ball((0.3, -0.1, 0.05), 0.06), Box((0.0, -0.1, 0.0), (0.2, 0.0, 0.3))),
    apart=0.3,
)


def test_terms_are_the_means_over_manipulations_of_what_files_would_show() -> None:
    """In the labels of each plan's equivalent; null manipulations move no hands."""
    plans = PLANS.copy()
    # The toy's shift is u1 v1 in the labels of the equivalent: those are equal for the first hand in the middle.
    plans[:, 0, :2] = 0
    found = evaluated(jnp.asarray(plans), 0.0)
    for row, plan in enumerate(plans):
        away, deep, close = np.zeros(3)
        for points in paths_of(plan):
            if not len(points):
                continue
            both, single = np.concatenate([points, points])[:2], np.array(len(points) == 1)
            away += out_of_reach(LIMITS.hands, both, single)[0].sum() / 2
            deep += sum(in_zone(zone, both, single).sum() for zone in LIMITS.keep_out) / 2
            close += float(too_close(LIMITS.apart, both, single)) / 2
        for name, expected in (("out_of_reach", away), ("in_zones", deep), ("too_close", close)):
            assert float(found.terms[name][row]) == pytest.approx(expected, abs=1e-5)
    more = sum(found.terms[name] for name in ("out_of_reach", "in_zones", "too_close"))
    usual = found.terms["accuracy"].sum(-1) + toy.WEIGHTS.alpha * found.terms["uncertainty"]
    np.testing.assert_allclose(found.loss, usual + 10 * more, rtol=1e-5)


@settings(max_examples=20)
@given(arrays(np.float32, (3, 2, 6), elements=st.floats(-1, 1, width=32)), st.floats(0.0, 0.1))
def test_gradients_are_bounded_and_finite(plans: np.ndarray, margin: float) -> None:
    def total(plan: jax.Array) -> jax.Array:
        found = evaluated(plan, margin)
        return sum(found.terms[name].sum() for name in ("out_of_reach", "in_zones", "too_close"))

    slope = np.asarray(jax.grad(total)(jnp.asarray(plans)))
    assert np.isfinite(slope).all()
    # A grasp point or a release that moves by 1 moves a hand by less than 3 m here.
    assert np.abs(slope).max() < 50


def test_breaches_name_the_step_and_the_limit() -> None:
    paths = [np.zeros((0, 5, 3)), np.array([[[0.0, 0, 0], [0.5, 0, 0.1]], [[0, 0.1, 0], [0.5, 0.1, 0.1]]])]
    box, ball = Box((-1, -1, -1), (0.3, 1, 1)), Ball((0.0, 0, 0), 0.2)
    assert breaches(Limits((box,)), paths[:1]) == []
    (out,) = breaches(Limits((box,)), paths)
    assert (out.step, out.limit) == (2, "outside the box (-1, -1, -1)..(0.3, 1, 1)")
    assert out.distance == pytest.approx(0.2)
    (inside, close) = breaches(Limits((), (ball,), 0.25), paths)
    assert (inside.step, inside.limit) == (2, "inside the ball of radius 0.2 around (0, 0, 0)")
    assert inside.distance == pytest.approx(0.2)
    assert close.distance == pytest.approx(0.15)
    assert close.limit == "nearer to the other one than the 0.25 m between them"
    two = Limits((box, Box((0.3, -1, -1), (1, 1, 1))))
    assert hands_of(two, np.array([[[0.9, 0, 0]], [[0.1, 0, 0]]])) == (1, 0)
    assert hands_of(two, np.array([[[0.1, 0, 0]], [[0.9, 0, 0]]])) == (0, 1)
    assert hands_of(two, np.array([[[0.9, 0, 0]]])) == (1,)
    assert hands_of(Limits((box,)), paths[1]) is None
    assert graspable(Limits((box,), (ball,)), np.array([[0.1, 0, 0], [0.25, 0, 0], [0.4, 0, 0]])).tolist() == [
        False,
        True,
        False,
    ]
    assert graspable(Limits(), np.zeros((2, 3))).all()
    assert not Limits()
    assert Limits(apart=0.1)


def test_hands_of_plans_in_voxels_grasp_on_the_table() -> None:
    outlook = outlook_of(PLANS[:, :1], MESH_0, np.zeros((1, 3, 2), np.float32), VOXEL)
    found = waypoints(SITUATION, outlook, 0)
    expected = np.concatenate([PLANS[:, 0, :4].reshape(3, 2, 2) * SCALE + CENTRE, np.zeros((3, 2, 1))], axis=-1)
    np.testing.assert_allclose(found[0, :, :, 0], expected, atol=1e-6)


GOAL = np.asarray(toy.dragged(jnp.asarray(MESH_0), jnp.array([-1.0, -1.0, -1.0, -1.0, 0.7, 0.4])))


@jax.jit
def _found(low: jax.Array, high: jax.Array, key: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """What a search finds for the goal with a box for both hands."""
    limits = Limits((Box(low, high),), apart=0.1)  # type: ignore[arg-type]
    objective = objective_of(2, toy.NORMALISATION.reference(1), toy.WEIGHTS)
    situation = SITUATION._replace(progress=PROGRESS)
    for name, term in terms_of(limits, situation, weight=1000.0, net=0).items():
        objective = objective.with_term(name, term)
    asked = problem(MESH_0, GOAL)
    problems = jax.tree.map(lambda part: jnp.asarray(part)[None], asked)
    found = search(toy.MODEL, MESH, toy.NETS, problems, objective, length=1, settings=toy.SEARCH, keys=key.reshape(1))
    return found.plan[0], found.terms["out_of_reach"][0], found.terms["accuracy"][0]


@settings(max_examples=12)
@given(arrays(np.float64, 4, elements=st.floats(-0.25, 0.25)), st.integers(0, 3))
def test_plans_stay_inside_where_they_can(edges: np.ndarray, seed: int) -> None:
    """A null manipulation is always possible, so that every box can be kept to, and nothing better is missed by it."""
    x, y = np.sort(edges[:2]), np.sort(edges[2:])
    low = np.array([x[0] + CENTRE[0], y[0] + CENTRE[1], -0.1])
    high = np.array([x[1] + CENTRE[0], y[1] + CENTRE[1], 0.4])
    plan, away, _ = _found(jnp.asarray(low, jnp.float32), jnp.asarray(high, jnp.float32), jax.random.key(seed))
    plan = np.asarray(plan)
    if not bool(np.all(is_null(plan))):
        paths = [hand_paths(plan[0], MESH_0, Pose(np.eye(3), np.zeros(3), CENTRE, SCALE), MOTION).points]
        assert breaches(Limits((Box(low, high),), apart=0.1), paths) == []
    assert float(away) <= 1e-6
