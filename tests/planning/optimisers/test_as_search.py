"""The gradient optimiser is the search of search.py: the same keys give the same plans, in the toy world of planning.

As stages compile, all bits are equal. Without the compiler's optimisations, as in tests, plans that a search evaluates
on its way have a loss that differs in the last bit once in some thousand times.
"""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from clothkit.planning.draw import EXTENT, RASTER, folds, random_plans, snap
from jaxtyping import Array

from clothkit.cloth.equivalents import COUNT, relabel_manipulation_batch
from clothkit.cloth.silhouette import pixel_centres
from clothkit.manipulation.geometry import release_points
from clothkit.manipulation.vector import is_null
from clothkit.planning import search as today
from clothkit.planning.optimisers.gradient import GradientConfig
from clothkit.planning.optimisers.registry import optimise
from clothkit.planning.optimisers.space import Evaluation, Initial, Plans, Result, Space
from tests.planning import toy
from tests.planning.test_search import BEST, find, problem

LENGTH = 2
SIZES = {
    "plain": toy.SEARCH,
    "all": dataclasses.replace(toy.SEARCH, screen=2, near=0.5, fold=True, base_iterations=2, iterations_per_step=8),
}


def searched(size: today.SearchConfig, one: today.Problem, key: Array) -> Result:
    """One search by the optimiser, whose space and objective are made of search.py's functions."""
    forward, labels = toy.FORWARD, toy.FORWARD.labels
    one = jax.tree.map(jnp.asarray, one)
    xy = forward.points(one.state, one.candidates.grasps)
    fixed = today.fix(forward, toy.NETS, one)
    loss_of = partial(
        today.planning_loss, forward, toy.NETS, fixed, toy.NORMALISATION.reference(LENGTH), toy.WEIGHTS, explicit=True
    )

    def sample(count: int, *, draws: int = 1, key: Array) -> Plans:
        key_plan, key_common = jax.random.split(key)
        rows = count * draws
        drawn = jax.random.randint(key_common, (rows,), 0, labels)
        common = jnp.where(one.later, jnp.arange(rows) // draws % labels, drawn)
        covered = one.covered if size.fold else None
        plan = random_plans(rows, LENGTH, one.candidates, xy, covered=covered, key=key_plan)
        return Plans(plan, (common, jnp.full(rows, one.relative)))

    def valid(plans: Plans) -> Array:
        first = plans.plan[:, 0]
        grasps = forward.points(one.state, first[:, :4].reshape(-1, 2, 2))
        fine = jnp.asarray(release_points(grasps, first[:, 4:]).same_side) | is_null(first)
        if size.fold:
            assert one.covered is not None
            fine &= folds(one.covered, grasps, first)
        return fine

    def evaluate(plans: Plans, *, steps: Array | None = None, exact: bool = False) -> Evaluation:
        common, relative = plans.labels
        plan = relabel_manipulation_batch(plans.plan, common)
        loss, terms, relative = loss_of(plan, common, relative, every=1 if exact else size.every)
        return Evaluation(loss, (common, relative), terms)

    first = snap(one.carried[0], forward.points(one.state, one.carried[0, :4].reshape(2, 2)), one.candidates, xy)
    carried = jnp.broadcast_to(jnp.concatenate([first[None], one.carried[1:]]), (labels, LENGTH, 6))
    initial = Initial(
        Plans(carried, (jnp.arange(labels), jnp.full(labels, one.relative))), jnp.broadcast_to(one.later, (labels,))
    )
    space = Space(LENGTH, one.candidates.grasps, one.candidates.present, sample, valid)
    names = {field.name for field in dataclasses.fields(GradientConfig)} - {"halvings"}
    settings = GradientConfig(**{name: getattr(size, name) for name in names})
    return optimise(evaluate, space, settings, initial=initial, key=key)


@pytest.mark.parametrize("size", SIZES)
def test_the_same_bits_as_search(size: str) -> None:
    mesh = toy.bent()
    goal = np.asarray(toy.dragged(toy.dragged(jnp.asarray(mesh), BEST), jnp.array([0.9, 1, 0.9, 1, -0.5, -0.6])))
    covered = np.broadcast_to((pixel_centres(RASTER, EXTENT) < 0.5)[:, None], (RASTER, RASTER))
    carried = np.array([[-0.9, -1, -0.9, -1, 0.6, 0.5], [0.8, 1, 0.8, 1, -0.4, -0.6]], np.float32)
    asked = [
        problem(mesh, goal, LENGTH, covered=covered),
        problem(mesh, goal, LENGTH, covered=covered, carried=carried, later=np.bool_(True), relative=np.int32(3)),
    ]
    expected = find(*asked, length=LENGTH, seeds=(4, 5), size=SIZES[size])
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *asked)
    keys = jnp.stack([jax.random.key(4), jax.random.key(5)])
    got = jax.tree.map(np.asarray, jax.jit(jax.vmap(partial(searched, SIZES[size])))(stacked, keys))
    np.testing.assert_allclose(got.losses, expected.losses, rtol=3e-7)
    np.testing.assert_array_equal(got.restarts, expected.restarts)
    np.testing.assert_array_equal(got.plan, expected.plan)
    np.testing.assert_array_equal(got.loss, expected.loss)
    np.testing.assert_array_equal(got.terms, expected.terms)
    np.testing.assert_array_equal(got.labels[0], expected.common)
    np.testing.assert_array_equal(got.labels[1], expected.relative)
    assert np.isfinite(got.loss).all()
    assert np.isfinite(got.losses[1, 0, :COUNT]).all()
