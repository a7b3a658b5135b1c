import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.mesh import best_label, error
from clothkit.cloth.symmetry import (
    equal_labellings,
    equivalent_cloths,
    equivalents,
    equivalents_of_manipulation,
    relabel,
    relabel_batch,
    relabel_cloth,
    relabel_manipulation,
    relabel_manipulation_batch,
)
from clothkit.cloth.topology import SQUARE, SWAP, Topology, rectangle, square
from clothkit.manipulation.geometry import to_cartesian

TOPOLOGIES = [square(6), rectangle(1.5, shape=(6, 6)), rectangle(1.5, shape=(6, 4)), Topology((5, 6), (0.5, 1.4))]
CHOSEN = st.sampled_from(TOPOLOGIES)
RNG = np.random.default_rng(0)


def mesh_of(topology: Topology) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(*topology.shape, 3)).astype(np.float32)


@given(CHOSEN, st.data())
def test_relabelling_follows_the_group(topology: Topology, data: st.DataObject) -> None:
    j, k = (data.draw(st.integers(0, topology.count - 1)) for _ in range(2))
    mesh = mesh_of(topology)
    twice = relabel(relabel(mesh, j, topology), k, topology)
    np.testing.assert_array_equal(twice, relabel(mesh, int(topology.composed[j, k]), topology))


@given(CHOSEN)
def test_equivalents_are_different_and_keep_every_vertex_and_neighbour(topology: Topology) -> None:
    mesh = mesh_of(topology)
    every = np.asarray(equivalents(mesh, topology))
    assert len({m.tobytes() for m in every}) == topology.count
    steps = np.sort(np.linalg.norm(np.diff(mesh, axis=0), axis=-1).ravel())
    across = np.sort(np.linalg.norm(np.diff(mesh, axis=1), axis=-1).ravel())
    for symmetry, equivalent in zip(topology.symmetries, every, strict=True):
        found = np.sort(np.linalg.norm(np.diff(equivalent, axis=0), axis=-1).ravel())
        np.testing.assert_allclose(found, across if symmetry & SWAP else steps, rtol=1e-6)


@given(CHOSEN, st.data(), st.lists(st.floats(-1, 1, width=32), min_size=4, max_size=4))
def test_a_relabelled_manipulation_grasps_the_same_points(
    topology: Topology, data: st.DataObject, grasps: list[float]
) -> None:
    k = data.draw(st.integers(0, topology.count - 1))
    mesh, manipulation = mesh_of(topology), np.array([*grasps, 0.3, -0.4], np.float32)
    moved = np.asarray(relabel_manipulation(manipulation, k, topology))
    for hand in (slice(0, 2), slice(2, 4)):
        np.testing.assert_allclose(
            to_cartesian(relabel(mesh, k, topology), moved[hand]), to_cartesian(mesh, manipulation[hand]), atol=1e-4
        )
    np.testing.assert_array_equal(moved[4:], manipulation[4:])


def test_batches_take_a_k_each() -> None:
    for topology in (square(4), rectangle(1.5, shape=(4, 4)), rectangle(0.5, shape=(4, 5))):
        count = topology.count
        meshes = RNG.normal(size=(count, 2, *topology.shape, 3)).astype(np.float32)
        manipulations = RNG.uniform(-1, 1, (count, 3, 6)).astype(np.float32)
        k = np.arange(count)[::-1].copy()
        together = relabel_batch(meshes, k, topology)
        moved = relabel_manipulation_batch(manipulations, k, topology)
        for i in range(count):
            np.testing.assert_array_equal(together[i], relabel(meshes[i], int(k[i]), topology))
            expected = equivalents_of_manipulation(manipulations[i], topology)[int(k[i])]
            np.testing.assert_array_equal(moved[i], expected)


def test_the_squares_symmetries_are_in_order_of_their_bits() -> None:
    """Records and plans of the paper's chain hold these numbers."""
    mesh = mesh_of(square(6))
    for k in range(8):
        expected = np.swapaxes(mesh, 0, 1) if k & 1 else mesh
        expected = expected[::-1] if k & 2 else expected
        expected = expected[:, ::-1] if k & 4 else expected
        np.testing.assert_array_equal(relabel(mesh, k), expected)
    assert SQUARE.symmetries == tuple(range(8))


@given(st.floats(0.3, 1.4), st.floats(0.3, 1.4), st.integers(0, 7))
def test_a_relabelled_cloth_has_the_sides_of_its_relabelled_mesh(along_u: float, along_v: float, k: int) -> None:
    cloth = np.array([along_u, along_v, 0.01], np.float32)
    u, v = np.meshgrid(np.linspace(0, along_u, 5), np.linspace(0, along_v, 5), indexing="ij")
    moved = np.asarray(relabel(np.stack([u, v, 0 * u], -1).astype(np.float32), k, square(5)))
    sides = [np.linalg.norm(moved[-1, 0] - moved[0, 0]), np.linalg.norm(moved[0, -1] - moved[0, 0])]
    np.testing.assert_allclose(relabel_cloth(cloth, k), [*sides, 0.01], rtol=1e-5)
    # Which labellings keep the sides is what these say.
    kept = np.allclose(relabel_cloth(cloth, k), cloth, atol=1e-3)
    assert bool(equal_labellings(cloth)[k]) == kept
    np.testing.assert_array_equal(equivalent_cloths(cloth)[k], relabel_cloth(cloth, k))


def test_only_labellings_that_keep_the_sides_count_as_the_same_cloth() -> None:
    flat = rectangle(1.6, shape=(6, 6)).flat()
    cloth = np.array([1.4, 1.4 / 1.6, 0.01], np.float32)
    swapped = np.swapaxes(flat, 0, 1)
    # A square's swapped labelling is its equal, a rectangle's is another cloth.
    assert float(error(swapped, flat)) == 0
    assert float(error(swapped, flat, cloth=cloth)) > 0.2
    assert float(error(np.asarray(flat)[::-1], flat, cloth=cloth)) == 0
    batch = np.stack([swapped, swapped])
    cloths = np.stack([cloth, [1.4, 1.4, 0.01]]).astype(np.float32)
    expected = [True, False]
    np.testing.assert_array_equal(error(batch, np.stack([flat, flat]), cloth=cloths) > 0.2, expected)
    # One cloth counts for a whole batch, and each cloth for every outcome of its own.
    np.testing.assert_array_equal(error(batch, np.stack([flat, flat]), cloth=cloth) > 0.2, [True, True])
    outcomes = np.tile(batch, (3, 1, 1, 1, 1))
    np.testing.assert_array_equal(error(outcomes, np.tile(flat, (3, 2, 1, 1, 1)), cloth=cloths) > 0.2, [expected] * 3)
    assert int(best_label(swapped, flat)) == SWAP
    assert not int(best_label(swapped, flat, cloth=cloth)) & SWAP
