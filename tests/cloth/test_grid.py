import numpy as np

from clothkit.cloth.grid import CLOTH_SIDE, edges, flat, geodesic, springs, thinned, triangles


def test_flat_cloth_spans_the_normalised_square() -> None:
    mesh = flat()
    assert mesh.shape == (32, 32, 3)
    np.testing.assert_allclose(mesh[0, 0], [-0.7, -0.7, 0], atol=1e-6)
    np.testing.assert_allclose(mesh[31, 0], [0.7, -0.7, 0], atol=1e-6)
    np.testing.assert_allclose(geodesic()[31, 0], [1, -1])


def test_triangles_tile_the_cloth_and_face_up() -> None:
    corners = flat(9).reshape(-1, 3)[triangles(9)].astype(float)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()
    np.testing.assert_allclose(normals[:, 2].sum() / 2, CLOTH_SIDE**2, rtol=1e-5)


def test_edges_are_those_of_the_triangles() -> None:
    of_triangles = {frozenset(pair) for t in triangles(6).tolist() for pair in zip(t, t[1:] + t[:1], strict=True)}
    assert {frozenset(e) for e in edges(6).tolist()} == of_triangles
    assert len(edges(6)) == len(of_triangles)


def test_springs_join_the_neighbours_of_equation_11() -> None:
    side = 5
    expected = set()
    for u, v in np.ndindex(side, side):
        for du, dv in [(0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0)]:
            if 0 <= u + du < side and 0 <= v + dv < side:
                expected.add((u * side + v, (u + du) * side + v + dv))
    ends, rest = springs(side)
    assert {tuple(pair) for pair in ends.tolist()} == expected
    positions = flat(side).reshape(-1, 3)
    np.testing.assert_allclose(np.linalg.norm(positions[ends[:, 0]] - positions[ends[:, 1]], axis=-1), rest, rtol=1e-5)


def test_kept_vertices_by_hand() -> None:
    """Every fourth from both ends of a side, so that the same ones are kept whichever end is the first."""
    mesh = np.stack(np.meshgrid(np.arange(32), np.arange(32), indexing="ij"), axis=-1)
    kept = thinned(mesh, 4)
    assert kept[:, 0, 0].tolist() == kept[0, :, 1].tolist() == [1, 5, 9, 13, 18, 22, 26, 30]
