import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.cloth.topology import SQUARE
from clothkit.manipulation.geometry import release_points, to_cartesian
from clothkit.manipulation.turns import planar, turn_manipulation, turn_mesh
from clothkit.manipulation.vector import is_null, is_single, swap_grasps

MANIPULATION = np.float32([-1, -1, -1, 1, 0.9, 0.2])


def test_null_and_single_by_hand() -> None:
    assert not is_null(MANIPULATION)
    assert is_null(np.float32([-1, -1, -1, 1, 0.48, 0.05]))
    assert not is_null(np.float32([-1, -1, -1, 1, 0, 0.491]))
    assert not is_single(MANIPULATION)
    assert is_single(np.float32([0.3, 1, 0.3, 1, 1, 0]))


def test_swapped_hands_release_at_swapped_points() -> None:
    swapped = np.asarray(swap_grasps(MANIPULATION))
    np.testing.assert_array_equal(swapped, [-1, 1, -1, -1, np.float32(0.9), np.float32(0.2)])


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_turned_manipulation_of_the_turned_cloth_releases_at_the_turned_points(mirrored: bool) -> None:
    matrix = planar(jnp.array(0.7), jnp.array(mirrored))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(2), atol=1e-6)
    assert float(jnp.linalg.det(matrix)) == pytest.approx(-1 if mirrored else 1, rel=1e-5)
    mesh, manipulation = jnp.asarray(SQUARE.flat()), jnp.asarray(MANIPULATION)
    turned_mesh, turned = turn_mesh(mesh, matrix), turn_manipulation(manipulation, matrix)

    def releases(mesh: jnp.ndarray, m: jnp.ndarray) -> np.ndarray:
        grasps = jnp.stack([to_cartesian(mesh, m[0:2])[:2], to_cartesian(mesh, m[2:4])[:2]])
        return np.asarray(release_points(grasps, m[4:6]).points)

    expected = releases(mesh, manipulation) @ np.asarray(matrix).T
    np.testing.assert_allclose(releases(turned_mesh, turned), expected, atol=1e-5)
