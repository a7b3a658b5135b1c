"""Random plans and snapping, counted and computed by hand."""

import jax
import jax.numpy as jnp
import numpy as np

from clothkit.cloth.grid import flat
from clothkit.planning.draw import Candidates, random_manipulations, random_plans, snap
from clothkit.planning.forward import points

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


def test_snapping_takes_the_nearest_candidate_in_xy() -> None:
    # The cloth folded over u = 0: the far corner lies on the near one.
    mesh = flat().copy()
    mesh[..., 0] = -np.abs(mesh[..., 0])
    candidates = Candidates(jnp.array([[-1.0, -1], [-1, 1], [9, 9]]), 2)
    manipulation = jnp.array([1.0, 0.9, -0.8, -0.9, 0.5, 0.6])
    wanted, xy = (points(jnp.asarray(mesh), uv) for uv in (manipulation[:4].reshape(2, 2), candidates.grasps))
    snapped = snap(manipulation, wanted, candidates, xy)
    np.testing.assert_allclose(snapped, [-1, 1, -1, -1, 0.5, 0.6])
