import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.equivalents import (
    compose,
    equivalents,
    equivalents_of_manipulation,
    inverse,
    relabel,
    relabel_batch,
    relabel_manipulation,
    relabel_manipulation_batch,
)
from clothkit.manipulation.geometry import to_cartesian

ELEMENT = st.integers(0, 7)
RNG = np.random.default_rng(0)
MESH = RNG.normal(size=(6, 6, 3)).astype(np.float32)


@given(ELEMENT, ELEMENT, ELEMENT)
def test_they_form_a_group(i: int, j: int, k: int) -> None:
    assert compose(compose(i, j), k) == compose(i, compose(j, k))
    assert compose(i, 0) == compose(0, i) == i
    assert compose(i, inverse(i)) == compose(inverse(i), i) == 0


def test_the_group_is_the_squares_and_not_another_of_order_eight() -> None:
    orders = []
    for k in range(8):
        power, order = k, 1
        while power:
            power, order = compose(power, k), order + 1
        orders.append(order)
    assert sorted(orders) == [1, 2, 2, 2, 2, 2, 4, 4]


@given(ELEMENT, ELEMENT)
def test_relabelling_follows_the_group(j: int, k: int) -> None:
    np.testing.assert_array_equal(relabel(relabel(MESH, j), k), relabel(MESH, compose(j, k)))


def test_the_eight_are_different_and_keep_every_vertex_and_neighbour() -> None:
    every = np.asarray(equivalents(MESH))
    assert len({m.tobytes() for m in every}) == 8
    steps = np.sort(np.linalg.norm(np.diff(MESH, axis=0), axis=-1).ravel())
    across = np.sort(np.linalg.norm(np.diff(MESH, axis=1), axis=-1).ravel())
    for k, mesh in enumerate(every):
        np.testing.assert_array_equal(mesh, relabel(MESH, k))
        found = np.sort(np.linalg.norm(np.diff(mesh, axis=0), axis=-1).ravel())
        np.testing.assert_allclose(found, across if k & 1 else steps, rtol=1e-6)


@given(ELEMENT, st.lists(st.floats(-1, 1, width=32), min_size=4, max_size=4))
def test_a_relabelled_manipulation_grasps_the_same_points(k: int, grasps: list[float]) -> None:
    manipulation = np.array([*grasps, 0.3, -0.4], np.float32)
    moved = np.asarray(relabel_manipulation(manipulation, k))
    for hand in (slice(0, 2), slice(2, 4)):
        np.testing.assert_allclose(
            to_cartesian(relabel(MESH, k), moved[hand]), to_cartesian(MESH, manipulation[hand]), atol=1e-4
        )
    np.testing.assert_array_equal(moved[4:], manipulation[4:])


def test_batches_take_a_k_each() -> None:
    meshes = RNG.normal(size=(8, 2, 4, 4, 3)).astype(np.float32)
    manipulations = RNG.uniform(-1, 1, (8, 3, 6)).astype(np.float32)
    k = np.arange(8)[::-1].copy()
    together = relabel_batch(meshes, k)
    moved = relabel_manipulation_batch(manipulations, k)
    for i in range(8):
        np.testing.assert_array_equal(together[i], relabel(meshes[i], int(k[i])))
        np.testing.assert_array_equal(moved[i], equivalents_of_manipulation(manipulations[i])[int(k[i])])
