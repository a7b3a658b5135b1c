"""A grid is told from its positions and triangles, whatever the order in which they are written."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clothkit.cloth.topology import SQUARE, Topology, rectangle, square
from clothkit.observation.grids import grid_order, is_grid, welded
from tests.observation.scenes import cornered

MESH = cornered()
TOLERANCE = 1e-6
CORNERS = [(0, 0), (0, 31), (31, 0), (31, 31)]


def sheet(rows: int, columns: int, diagonals: np.ndarray) -> np.ndarray:
    """Triangles of a grid of so many vertices; each quad's diagonal by whether `diagonals` is set."""
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    one = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1)
    other = np.stack([np.stack([a, b, d], 1), np.stack([b, c, d], 1)], 1)
    return np.where(diagonals.reshape(-1, 1, 1), one, other).reshape(-1, 3)


def alike(found: np.ndarray, mesh: np.ndarray) -> bool:
    """Whether a mesh is another in one of its eight symmetric orders."""
    orders = [np.rot90(side, turns) for side in (mesh, mesh.transpose(1, 0, 2)) for turns in range(4)]
    return min(float(np.abs(found - order).max()) for order in orders) == 0


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**16),
    share=st.sampled_from([0.0, 0.5, 1.0]),
    apart=st.booleans(),
    both_sides=st.booleans(),
    rolled=st.booleans(),
)
def test_a_grid_is_found_in_any_order(seed: int, share: float, apart: bool, both_sides: bool, rolled: bool) -> None:
    random = np.random.default_rng(seed)
    mesh = SQUARE.flat().astype(float) if rolled else MESH
    faces = random.permutation(sheet(*SQUARE.shape, random.random(961) < share))
    faces = np.stack([np.roll(face, random.integers(3)) for face in faces])
    if both_sides:
        faces = np.concatenate([faces, faces[:, ::-1]])
    vertices = mesh.reshape(-1, 3)
    if apart:
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
    order = random.permutation(len(vertices))
    vertices, faces = vertices[order], np.argsort(order)[faces]
    found = grid_order(vertices, faces, tolerance=TOLERANCE)
    assert found is not None
    assert alike(vertices[found].reshape(*SQUARE.shape, 3), mesh)


def test_our_own_order_stays() -> None:
    vertices = MESH.reshape(-1, 3)
    np.testing.assert_array_equal(grid_order(vertices, SQUARE.triangles(), tolerance=TOLERANCE), np.arange(1024))
    # Each vertex once for each triangle, in the triangles' order.
    apart = vertices[SQUARE.triangles()].reshape(-1, 3)
    found = grid_order(apart, np.arange(len(apart)).reshape(-1, 3), tolerance=TOLERANCE)
    assert found is not None
    np.testing.assert_array_equal(apart[found], vertices)


def test_layers_that_touch_stay_apart() -> None:
    """Half of the cloth lies on the other half, vertex on vertex."""
    folded = SQUARE.flat().astype(float)
    folded[16:] = folded[15::-1]
    order = np.random.default_rng(1).permutation(1024)
    vertices = folded.reshape(-1, 3)[order]
    found = grid_order(vertices, np.argsort(order)[SQUARE.triangles()], tolerance=TOLERANCE)
    assert found is not None
    assert alike(vertices[found].reshape(*SQUARE.shape, 3), folded)


def others() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    random = np.random.default_rng(2)
    vertices, faces = MESH.reshape(-1, 3), SQUARE.triangles()
    long = np.stack(np.meshgrid(np.arange(16.0), np.arange(64.0), [0.0], indexing="ij"), -1).reshape(-1, 3)
    closed = np.concatenate([faces, [[31, 1023, 0]], [[0, 1023, 992]]])
    twisted = faces.copy()
    twisted[0] = [0, 1, 40]
    return {
        "a hole": (vertices, faces[np.arange(len(faces)) != 700]),
        "a bridge": (vertices, closed),
        "a wrong triangle": (vertices, twisted),
        "no triangle of a corner": (vertices, np.concatenate([faces[2:], faces[2:4]])),
        "16 by 64": (long, sheet(16, 64, np.ones(15 * 63, bool))),
        "31 by 32": (vertices[:992], sheet(31, 32, np.ones(30 * 31, bool))),
        "any triangles": (vertices, random.integers(0, 1024, faces.shape)),
        "none": (vertices, np.zeros((0, 3), int)),
        "one, over and over": (vertices, np.tile([[0, 1, 2]], (1922, 1))),
    }


@pytest.mark.parametrize("name", others())
def test_anything_else_is_none(name: str) -> None:
    vertices, faces = others()[name]
    assert grid_order(vertices, faces, tolerance=TOLERANCE) is None
    order = np.random.default_rng(3).permutation(len(vertices))
    assert grid_order(vertices[order], np.argsort(order)[faces], tolerance=TOLERANCE) is None


def test_is_grid_wants_two_triangles_within_each_quad() -> None:
    assert is_grid(1024, sheet(*SQUARE.shape, np.arange(961) % 2 == 0))
    assert not is_grid(1024, SQUARE.triangles()[np.r_[0, 0, 2:1922]])
    assert not is_grid(1025, SQUARE.triangles())


@given(st.integers(0, 2**16))
def test_welding_joins_what_is_near_and_nothing_else(seed: int) -> None:
    random = np.random.default_rng(seed)
    places = np.unique(random.integers(-5, 5, (30, 3)), axis=0).astype(float)
    which = random.integers(0, len(places), 100)
    vertices = places[which] + random.uniform(-0.04, 0.04, (100, 3))
    found = welded(vertices, 0.15)
    np.testing.assert_array_equal(found[:, None] == found, which[:, None] == which)
    np.testing.assert_array_equal(found, [int(np.flatnonzero(which == one)[0]) for one in which])


def test_however_many_vertices_lie_in_one_place() -> None:
    np.testing.assert_array_equal(welded(np.zeros((200_000, 3)), 1e-6), np.zeros(200_000))


UNLIKE = [
    rectangle(1.8, shape=(8, 8)),
    rectangle(0.6, shape=(8, 8)),
    rectangle(2.0, shape=(6, 9)),
    Topology((9, 6), (1.4, 1.0)),
    square(8),
]


def symmetric(mesh: np.ndarray) -> list[np.ndarray]:
    """A mesh and its reversals along u, along v and along both."""
    return [np.flip(mesh, axes) for axes in ((), (0,), (1,), (0, 1))]


@pytest.mark.parametrize("topology", UNLIKE, ids=lambda t: f"{t.shape}-{t.sides}")
def test_rows_run_along_the_cloths_first_side_whatever_the_order_in_the_file(topology: Topology) -> None:
    mesh = topology.flat().astype(float)
    mesh[..., 2] = np.random.default_rng(4).normal(size=topology.shape) * 1e-3
    across = mesh.swapaxes(0, 1)
    expected = symmetric(mesh) + (symmetric(across) if topology.swaps else [])
    vertices, faces = mesh.reshape(-1, 3), topology.triangles()
    np.testing.assert_array_equal(grid_order(vertices, faces, topology, tolerance=TOLERANCE), np.arange(len(vertices)))
    order = np.random.default_rng(5).permutation(len(vertices))
    rows, columns = across.shape[:2]
    written = [
        (vertices[order], np.argsort(order)[faces]),
        (across.reshape(-1, 3), sheet(rows, columns, np.ones((rows - 1) * (columns - 1), bool))),
    ]
    for points, corners in written:
        found = grid_order(points, corners, topology, tolerance=TOLERANCE)
        assert found is not None
        assert any((points[found].reshape(mesh.shape) == one).all() for one in expected)
