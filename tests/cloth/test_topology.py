import itertools
from collections.abc import Callable

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.mesh import best_label, error
from clothkit.cloth.symmetry import equivalents, relabel
from clothkit.cloth.topology import (
    CLOTH_LENGTH,
    REVERSE_U,
    REVERSE_V,
    SQUARE,
    SWAP,
    Topology,
    rectangle,
    square,
    thinned,
)

STRIP = Topology((16, 32), (0.5, CLOTH_LENGTH), (0, REVERSE_V))
"""A strip whose two long edges differ, so that reversing v alone keeps what it is."""
RECTANGLE = rectangle(1.8)
ALL = [SQUARE, RECTANGLE, rectangle(0.6, shape=(9, 12)), STRIP, Topology((5, 4), (1.4, 0.7))]
EACH = pytest.mark.parametrize("topology", ALL, ids=lambda t: f"{t.shape}-{t.count}")
CHOSEN = st.sampled_from(ALL)


def permutations(topology: Topology) -> list[np.ndarray]:
    """For each symmetry, the number of the vertex that lies in each place of the relabelled grid."""
    numbered = np.arange(np.prod(topology.shape)).reshape(*topology.shape, 1)
    return [np.asarray(relabel(numbered, k, topology), int).ravel() for k in range(topology.count)]


def isometries(topology: Topology) -> set[tuple[int, ...]]:
    """The permutations of a flat cloth's corners that keep all distances between them, by trying all 24."""
    corners = topology.flat()[[0, 0, -1, -1], [0, -1, 0, -1]]
    apart = np.linalg.norm(corners[:, None] - corners, axis=-1)
    tried = (list(order) for order in itertools.permutations(range(4)))
    return {tuple(order) for order in tried if np.allclose(apart[order][:, order], apart, atol=1e-5)}


@pytest.mark.parametrize(("topology", "count"), [(SQUARE, 8), (square(5), 8), (RECTANGLE, 4), (rectangle(0.5), 4)])
def test_the_symmetries_are_all_isometries_of_the_flat_cloth(topology: Topology, count: int) -> None:
    corners = [
        np.ravel_multi_index((u, v), topology.shape)
        for u in (0, -1 % topology.shape[0])
        for v in (0, -1 % topology.shape[1])
    ]
    found = {tuple(corners.index(k) for k in each[corners]) for each in permutations(topology)}
    assert topology.count == count
    assert found == isometries(topology)


@EACH
def test_tables_are_those_of_the_permutations_of_vertices(topology: Topology) -> None:
    every = permutations(topology)
    place = {order.tobytes(): k for k, order in enumerate(every)}
    expected = [[place[first[second].tobytes()] for second in every] for first in every]
    np.testing.assert_array_equal(topology.composed, expected)
    np.testing.assert_array_equal(topology.inverses, [place[np.argsort(order).tobytes()] for order in every])


@given(CHOSEN, st.data())
def test_the_symmetries_form_a_group(topology: Topology, data: st.DataObject) -> None:
    i, j, k = (data.draw(st.integers(0, topology.count - 1)) for _ in range(3))
    composed, inverses = topology.composed, topology.inverses
    assert composed[composed[i, j], k] == composed[i, composed[j, k]]
    assert composed[i, 0] == composed[0, i] == i
    assert composed[i, inverses[i]] == composed[inverses[i], i] == 0


def test_the_group_is_the_squares_and_not_another_of_order_eight() -> None:
    orders = []
    for k in range(8):
        power, order = k, 1
        while power:
            power, order = SQUARE.composed[power, k], order + 1
        orders.append(order)
    assert sorted(orders) == [1, 2, 2, 2, 2, 2, 4, 4]


@given(CHOSEN, st.data())
def test_a_flat_cloth_that_is_relabelled_and_turned_back_is_unchanged(topology: Topology, data: st.DataObject) -> None:
    symmetry = data.draw(st.sampled_from(topology.symmetries))
    flat = topology.flat()
    mesh = np.asarray(relabel(flat, topology.symmetries.index(symmetry), topology))
    # The same to x and y as to u and v, in the same order.
    turned = mesh[..., [1, 0, 2]] if symmetry & SWAP else mesh
    signs = [-1 if symmetry & REVERSE_U else 1, -1 if symmetry & REVERSE_V else 1, 1]
    np.testing.assert_allclose(turned * signs, flat, atol=1e-6)


@EACH
def test_a_mesh_has_no_error_against_each_of_its_equivalents(topology: Topology) -> None:
    mesh = np.random.default_rng(0).normal(size=(*topology.shape, 3)).astype(np.float32)
    for k, other in enumerate(np.asarray(equivalents(mesh, topology))):
        np.testing.assert_array_equal(other, relabel(mesh, k, topology))
        assert float(error(mesh, other, topology=topology)) == 0
        assert int(topology.inverses[int(best_label(mesh, other, topology=topology))]) == k


def test_a_rectangle_has_an_error_when_its_axes_are_swapped_and_a_square_has_none() -> None:
    for topology, expected in ((square(32), 0.0), (RECTANGLE, 0.1)):
        flat = topology.flat()
        swapped = np.swapaxes(flat, 0, 1)
        assert float(error(flat, swapped, topology=topology)) >= expected
    assert float(error(SQUARE.flat(), np.swapaxes(SQUARE.flat(), 0, 1))) == 0


def test_the_symmetry_may_be_traced_and_the_topology_static() -> None:
    mesh = np.random.default_rng(1).normal(size=(*STRIP.shape, 3)).astype(np.float32)
    traced = jax.jit(relabel, static_argnames="topology")
    for topology in (STRIP, rectangle(2.0, shape=STRIP.shape)):
        for k in range(topology.count):
            np.testing.assert_array_equal(traced(mesh, k, topology=topology), relabel(mesh, k, topology))


def test_flat_cloths_have_the_sides_and_spacings_of_their_topology() -> None:
    assert SQUARE.flat().shape == (32, 32, 3)
    np.testing.assert_allclose(SQUARE.flat()[0, 0], [-0.7, -0.7, 0], atol=1e-6)
    np.testing.assert_allclose(SQUARE.flat()[31, 0], [0.7, -0.7, 0], atol=1e-6)
    np.testing.assert_allclose(SQUARE.geodesic()[31, 0], [1, -1])
    np.testing.assert_allclose(RECTANGLE.flat()[31, 31], [0.7, 0.7 / 1.8, 0], atol=1e-6)
    np.testing.assert_allclose(rectangle(0.6).flat()[0, 31], [-0.42, 0.7, 0], atol=1e-6)
    np.testing.assert_allclose(STRIP.spacing, [0.5 / 15, 1.4 / 31])
    for topology in ALL:
        steps = [np.diff(topology.flat(), axis=axis)[..., axis] for axis in (0, 1)]
        for step, spacing in zip(steps, topology.spacing, strict=True):
            np.testing.assert_allclose(step, spacing, atol=1e-6)


@EACH
def test_triangles_tile_the_cloth_and_face_up(topology: Topology) -> None:
    corners = topology.flat().reshape(-1, 3)[topology.triangles()].astype(float)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()
    np.testing.assert_allclose(normals[:, 2].sum() / 2, np.prod(topology.sides), rtol=1e-5)


@EACH
def test_edges_are_those_of_the_triangles(topology: Topology) -> None:
    of_triangles = {
        frozenset(pair) for t in topology.triangles().tolist() for pair in zip(t, t[1:] + t[:1], strict=True)
    }
    edges = topology.edges()
    assert {frozenset(e) for e in edges.tolist()} == of_triangles
    assert len(edges) == len(of_triangles)


@EACH
def test_springs_join_the_neighbours_of_equation_11_at_their_distance_on_the_flat_cloth(topology: Topology) -> None:
    rows, columns = topology.shape
    kinds = [(0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0)]
    expected = set()
    for u, v in np.ndindex(rows, columns):
        for du, dv in kinds:
            if 0 <= u + du < rows and 0 <= v + dv < columns:
                expected.add((u * columns + v, (u + du) * columns + v + dv))
    ends, rest = topology.springs()
    assert {tuple(pair) for pair in ends.tolist()} == expected
    assert len(ends) == len(expected)
    positions = topology.flat().reshape(-1, 3).astype(float)
    np.testing.assert_allclose(np.linalg.norm(positions[ends[:, 0]] - positions[ends[:, 1]], axis=-1), rest, rtol=1e-4)
    assert {(du, dv) for du, dv, _ in topology.spring_offsets} == set(kinds)
    along_u, along_v = topology.spacing
    for du, dv, length in topology.spring_offsets:
        assert length == pytest.approx(np.hypot(du * along_u, dv * along_v))


@pytest.mark.parametrize("stride", [1, 2, 4])
@EACH
def test_thinning_keeps_the_same_vertices_under_all_symmetries(topology: Topology, stride: int) -> None:
    mesh = np.random.default_rng(2).normal(size=(2, *topology.shape, 3)).astype(np.float32)
    for k in range(topology.count):
        np.testing.assert_array_equal(
            thinned(np.asarray(relabel(mesh, k, topology)), stride), relabel(thinned(mesh, stride), k, topology)
        )


def test_a_topology_is_a_value() -> None:
    assert square() == SQUARE
    assert hash(square()) == hash(SQUARE)
    assert len({rectangle(1.5), rectangle(1.5), rectangle(1.6)}) == 2
    SQUARE.composed[:] = 0
    assert SQUARE.composed[1, 2] != 0


REFUSED: list[tuple[Callable[[], Topology], str]] = [
    (lambda: Topology((8, 8), (1.4, 0.7), (0, SWAP)), "sides 1.4 x 0.7: swapping the axes does not map it onto itself"),
    (lambda: Topology((8, 9), (1.4, 1.4), (0, SWAP)), "8 x 9 vertices .* swapping the axes does not map it"),
    (lambda: Topology((8, 8), (1.0, 0.5)), "expected the longer to be 1.4"),
    (lambda: Topology((8, 8), (1.4, 0.0)), "with sides 1.4 x 0,"),
    (lambda: Topology((8, 1), (1.4, 1.4)), "8 x 1 vertices, expected at least 2"),
    (lambda: Topology((8, 8), (1.4, 0.7), (REVERSE_U, 0)), "the identity 0 first"),
    (lambda: Topology((8, 8), (1.4, 0.7), (0, REVERSE_U, REVERSE_U)), "expected different ones"),
    (lambda: Topology((8, 8), (1.4, 1.4), (0, 8)), "of 0 to 7"),
    (lambda: Topology((8, 8), (1.4, 1.4), ()), "the identity 0 first"),
    (lambda: Topology((8, 8), (1.4, 1.4), (0, REVERSE_U, REVERSE_V)), "are no group"),
    (lambda: Topology((8, 8), (1.4, 1.4), (0, SWAP | REVERSE_U)), "are no group"),
    (lambda: rectangle(0.0), "ratio 0, expected a number above 0"),
    (lambda: rectangle(float("nan")), "ratio nan"),
]


@pytest.mark.parametrize(("made", "told"), REFUSED)
def test_parts_that_do_not_fit_together_are_refused(made: Callable[[], Topology], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        made()


def test_kept_vertices_by_hand() -> None:
    """Every fourth from both ends of a side, so that the same ones are kept whichever end is the first."""
    mesh = np.stack(np.meshgrid(np.arange(32), np.arange(32), indexing="ij"), axis=-1)
    kept = thinned(mesh, 4)
    assert kept[:, 0, 0].tolist() == kept[0, :, 1].tolist() == [1, 5, 9, 13, 18, 22, 26, 30]
