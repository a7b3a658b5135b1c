import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.topology import SQUARE, Topology, rectangle, square
from clothkit.manipulation.geometry import (
    arc,
    nearest_vertex,
    release_points,
    to_cartesian,
    to_geodesic,
    topmost_vertex,
)

COORDINATE = st.floats(-1, 1, width=32)
RNG = np.random.default_rng(3)


def test_equation_1_by_hand() -> None:
    # Hands at (0, 0) and (0, 1), displacement (2, 0): p = (1, 0.5), m is x = 1, the images are (2, 0) and (2, 1).
    release = release_points(np.array([[0.0, 0.0], [0.0, 1.0]]), np.array([2.0, 0.0]))
    np.testing.assert_allclose(release.points, [[2, 0], [2, 1]])
    assert release.same_side
    # Hands at (0, 0) and (1, 0), displacement (2, 0): m is x = 1.5, so they travel 3 and 1.
    release = release_points(np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([2.0, 0.0]))
    np.testing.assert_allclose(release.points, [[3, 0], [2, 0]])
    # Hands at (0, 0) and (3, 0), displacement (1, 0): m is x = 2, between them.
    assert not release_points(np.array([[0.0, 0.0], [3.0, 0.0]]), np.array([1.0, 0.0])).same_side


@given(*[COORDINATE] * 6)
def test_release_points_mirror_over_the_line(ax: float, ay: float, bx: float, by: float, dx: float, dy: float) -> None:
    displacement = np.array([dx, dy]) + 0.01
    if np.linalg.norm(displacement) < 0.05:
        return
    grasps = np.array([[ax, ay], [bx, by]])
    release = release_points(grasps, displacement)
    p = grasps.mean(0) + displacement / 2
    middle = (grasps + release.points) / 2
    np.testing.assert_allclose((middle - p) @ displacement, 0, atol=1e-6)
    normal = np.array([-displacement[1], displacement[0]])
    np.testing.assert_allclose((release.points - grasps) @ normal, 0, atol=1e-6)
    again = release_points(release.points, -displacement)
    np.testing.assert_allclose(again.points, grasps, atol=1e-6)


@given(COORDINATE, COORDINATE, COORDINATE, COORDINATE)
def test_one_hand_moves_by_the_displacement(x: float, y: float, dx: float, dy: float) -> None:
    displacement = np.array([dx, dy]) + 0.1
    if np.linalg.norm(displacement) < 0.05:
        return
    release = release_points(np.array([[x, y], [x, y]]), displacement)
    np.testing.assert_allclose(release.points, np.array([[x, y], [x, y]]) + displacement, atol=1e-9)


@pytest.mark.parametrize(("k", "height"), [(0.3, 0.15), (0.4, 0.2), (1.0, 0.2)])
def test_arcs_are_circles_that_end_at_the_release_height(k: float, height: float) -> None:
    grasp = np.array([0.1, -0.2, 0.03])
    direction = np.array([0.6, 0.8])
    path = arc(grasp, grasp[:2] + k * direction)
    np.testing.assert_allclose(path.at(0.0), grasp, atol=1e-12)
    np.testing.assert_allclose(path.at(1.0), [*(grasp[:2] + k * direction), grasp[2] + height], atol=1e-12)
    centre = np.array([*(grasp[:2] + path.radius * direction), grasp[2]])
    points = np.array([path.at(float(t)) for t in np.linspace(0, 1, 21)])
    np.testing.assert_allclose(np.linalg.norm(points - centre, axis=-1), path.radius, rtol=1e-9)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    assert (points[:, 2] >= grasp[2] - 1e-12).all()


@given(COORDINATE, COORDINATE)
def test_the_flat_cloth_maps_geodesic_to_cartesian_linearly(u: float, v: float) -> None:
    np.testing.assert_allclose(to_cartesian(SQUARE.flat(), np.float32([u, v])), [0.7 * u, 0.7 * v, 0], atol=1e-5)


def test_vertices_are_interpolated_exactly_and_clipped_outside() -> None:
    mesh = RNG.normal(size=(32, 32, 3)).astype(np.float32)
    every = to_cartesian(np.broadcast_to(mesh, (32, 32, 32, 32, 3)), SQUARE.geodesic())
    np.testing.assert_allclose(every, mesh, atol=1e-4)
    np.testing.assert_allclose(to_cartesian(mesh, np.float32([3, -7])), mesh[31, 0], atol=1e-5)


def test_nearest_vertex_is_the_brute_force_one() -> None:
    mesh = RNG.normal(size=(8, 8, 3)).astype(np.float32)
    points = RNG.normal(size=(20, 2)).astype(np.float32)
    expected = [np.linalg.norm(mesh.reshape(-1, 3)[:, :2] - p, axis=1).argmin() for p in points]
    np.testing.assert_array_equal(nearest_vertex(mesh, points), expected)
    np.testing.assert_allclose(to_geodesic(mesh, points)[3], square(8).geodesic().reshape(-1, 2)[expected[3]])


def test_the_topmost_of_the_near_vertices_is_taken() -> None:
    folded = SQUARE.flat()
    folded[16:] = folded[15::-1] + np.float32([0.004, 0, 0.01])
    assert topmost_vertex(folded, np.float32([-0.7, -0.7]), within=0.02) == 31 * 32
    assert topmost_vertex(folded, np.float32([-0.7, -0.7]), within=0.001) == 0


@pytest.mark.parametrize("topology", [rectangle(1.8), Topology((5, 9), (0.5, 1.4))], ids=str)
def test_a_rectangles_points_lie_between_its_own_sides(topology: Topology) -> None:
    (along_u, along_v), flat = topology.sides, topology.flat()
    for u, v in ((-1, 1), (0.3, -0.7), (1, 0.05), (2, -3)):
        expected = np.clip([u, v], -1, 1) * [along_u / 2, along_v / 2]
        np.testing.assert_allclose(to_cartesian(flat, np.float32([u, v]))[:2], expected, atol=1e-5)
    points = flat[..., :2] + np.float32([0.01, -0.01])
    np.testing.assert_array_equal(to_geodesic(flat, points), topology.geodesic())
