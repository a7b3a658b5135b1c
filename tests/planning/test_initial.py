"""Random plans and snapping, counted and computed by hand."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from clothkit.cloth.silhouette import iou
from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import observe
from clothkit.manipulation.draws import random_manipulations
from clothkit.planning.initial import EXTENT, RASTER, folds, random_plans, snap
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.types import Candidates
from clothkit.planning.voxel_representation import VOXEL
from tests.observation.scenes import folded

POINTS = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1], [1, 0], [0, 0], [0, 0]], np.float32)
CANDIDATES = Candidates(POINTS, 5)
FLAT = 0.7 * jnp.asarray(POINTS)
"""Where they lie on the flat cloth."""


def test_plans_without_restrictions() -> None:
    drawn = np.asarray(random_manipulations((20000,), key=jax.random.key(0)))
    single = (drawn[:, :2] == drawn[:, 2:4]).all(-1)
    assert abs(single.mean() - 1 / 3) < 0.02
    np.testing.assert_allclose(drawn.min(0), [-1, -1, -1, -1, -1.4, -1.4], atol=1e-2)
    np.testing.assert_allclose(drawn.max(0), [1, 1, 1, 1, 1.4, 1.4], atol=1e-2)


def test_a_share_of_grasp_points_is_on_the_edge_and_half_of_it_at_corners() -> None:
    drawn = np.asarray(random_manipulations((20000,), edge=0.6, key=jax.random.key(0)))
    hand = np.abs(drawn[:, :2])
    # Uniform points lie nowhere exactly on the edge.
    np.testing.assert_allclose((hand == 1).any(1).mean(), 0.6, atol=0.01)
    np.testing.assert_allclose((hand == 1).all(1).mean(), 0.3, atol=0.01)
    # All four sides alike, and all of a side.
    sides = [(drawn[:, axis] == sign) & (hand[:, 1 - axis] < 1) for axis in (0, 1) for sign in (-1, 1)]
    np.testing.assert_allclose([side.mean() for side in sides], 0.3 / 4, atol=0.01)
    along = np.concatenate([drawn[side, 1 - axis] for side, axis in zip(sides, (0, 0, 1, 1), strict=True)])
    np.testing.assert_allclose(np.quantile(along, [0.25, 0.5, 0.75]), [-0.5, 0, 0.5], atol=0.05)
    single = (drawn[:, :2] == drawn[:, 2:4]).all(1)
    assert 0.3 < single[(hand < 1).all(1)].mean() < 0.37
    # What is not moved is as without.
    plain = np.asarray(random_manipulations((20000,), key=jax.random.key(0)))
    np.testing.assert_array_equal(drawn[(hand < 1).all(1), :2], plain[(hand < 1).all(1), :2])
    np.testing.assert_array_equal(drawn[:, 4:], plain[:, 4:])


def test_first_grasps_are_candidates_on_one_side_of_m() -> None:
    plans = np.asarray(random_plans(4000, 3, CANDIDATES, FLAT, key=jax.random.key(1)))
    first = plans[:, 0]
    grasps = first[:, :4].reshape(-1, 2, 2)
    index = np.abs(grasps[:, :, None] - POINTS[:5]).sum(-1).argmin(-1)
    np.testing.assert_allclose(POINTS[index], grasps)
    single = index[:, 0] == index[:, 1]
    assert abs(single.mean() - 1 / 3) < 0.03
    assert np.bincount(index.ravel(), minlength=5).min() > 800
    # On the flat cloth Cartesian is 0.7 times geodesic. p and m as in eq. (1).
    xy, d = 0.7 * grasps, first[:, 4:]
    p = (xy.sum(1) + d) / 2
    side = np.sign(((xy - p[:, None]) * d[:, None]).sum(-1))
    assert np.mean(side[:, 0] == side[:, 1]) > 0.999


def test_a_single_candidate_leaves_one_hand() -> None:
    plans = np.asarray(random_plans(50, 1, Candidates(POINTS, 1), FLAT, key=jax.random.key(2)))
    assert (plans[:, 0, :4] == -1).all()


def test_the_share_of_one_handed_manipulations() -> None:
    for share in (0.0, 0.7, 1.0):
        plans = np.asarray(random_plans(4000, 2, CANDIDATES, FLAT, one_handed=share, key=jax.random.key(4)))
        single = (plans[..., :2] == plans[..., 2:4]).all(-1)
        # In first manipulations, hands that lie on different sides of m are drawn again.
        np.testing.assert_allclose(single.mean(0), share, atol=0.03 if 0 < share < 1 else 0)


def test_snapping_takes_the_nearest_candidate_in_xy() -> None:
    # The cloth folded over u = 0: the far corner lies on the near one.
    mesh = SQUARE.flat().copy()
    mesh[..., 0] = -np.abs(mesh[..., 0])
    candidates = Candidates(jnp.array([[-1.0, -1], [-1, 1], [9, 9]]), 2)
    manipulation = jnp.array([1.0, 0.9, -0.8, -0.9, 0.5, 0.6])
    wanted, xy = (MESH.points(jnp.asarray(mesh), uv) for uv in (manipulation[:4].reshape(2, 2), candidates.grasps))
    snapped = snap(manipulation, wanted, candidates, xy)
    np.testing.assert_allclose(snapped, [-1, 1, -1, -1, 0.5, 0.6])


def test_starts_fold_the_cloth_where_it_is_told_what_it_covers() -> None:
    """q of section 4.4, by hand, lies on covered pixels, and everywhere on them."""
    covered = np.zeros((RASTER, RASTER), bool)
    covered[10:20, 30:34] = covered[40, 5] = True
    plans = np.asarray(random_plans(4000, 2, CANDIDATES, FLAT, covered=covered, key=jax.random.key(3)))
    first = plans[:, 0]
    q = 0.7 * first[:, :4].reshape(-1, 2, 2).mean(1) + 0.8 * first[:, 4:]
    pixel = np.floor((q + EXTENT) / (2 * EXTENT / RASTER)).astype(int)
    # Rounding may put a point on the border of its pixel.
    assert covered[pixel[:, 0], pixel[:, 1]].mean() > 0.995
    counts = np.zeros(covered.shape, int)
    np.add.at(counts, tuple(pixel.T), 1)
    assert (counts[covered] > 40).all()
    # Later manipulations are drawn as before.
    assert np.abs(plans[:, 1, 4:]).max() > 1.3


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_a_fold_has_its_q_on_the_silhouette(seed: int) -> None:
    random = np.random.default_rng(seed)
    mesh = folded(along=random.uniform(-0.2, 0.5), angle=random.uniform(0, 3))
    covered = MESH.covered(mesh)
    vertices = mesh.reshape(-1, 3)[random.integers(1024, size=2), :2]
    d = random.uniform(-1.4, 1.4, 2)
    manipulation = np.array([0, 0, 1, 1, *d], np.float32)
    q = vertices.mean(0) + 0.8 * d
    found = bool(folds(covered, jnp.asarray(vertices), jnp.asarray(manipulation)))
    # A pixel's diagonal is 0.049: farther than that from the border the raster can't be wrong.
    around = q + 0.05 * np.stack([np.cos(turns := np.linspace(0, 2 * np.pi, 24)), np.sin(turns)], axis=-1)
    on = on_triangles(mesh, np.concatenate([q[None], around]))
    if np.linalg.norm(d) < 0.49 or on.all():
        assert found
    elif not on.any():
        assert not found


def on_triangles(mesh: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether each point lies on one of the mesh's triangles, seen from above, by its signed areas."""
    a, b, c = (mesh.reshape(-1, 3)[SQUARE.triangles()[:, k], :2].astype(float) for k in range(3))
    p = points[:, None]
    areas = [(v - u)[:, 0] * (p - u)[..., 1] - (v - u)[:, 1] * (p - u)[..., 0] for u, v in ((a, b), (b, c), (c, a))]
    return ((np.minimum.reduce(areas) >= 0) | (np.maximum.reduce(areas) <= 0)).any(1)


def test_voxels_cover_what_the_mesh_covers() -> None:
    mesh = folded(along=0.2, angle=0.4)
    of_mesh = MESH.covered(mesh)
    of_voxels = VOXEL.covered(np.asarray(observe(mesh)))
    # A voxel is twice as wide as a pixel, so the border differs.
    assert iou(of_mesh, of_voxels) > 0.85
    assert of_voxels.shape == of_mesh.shape == (RASTER, RASTER)
    assert not of_voxels[0].any()
