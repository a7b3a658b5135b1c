"""The term that has a mesh explain what was seen, held against a loop over columns and vertices."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import HEIGHT, double, observe
from clothkit.estimation.agreement import agreement
from clothkit.estimation.explanation import MARGIN, WIDTH, bounds_of, columns, unexplained
from clothkit.estimation.refine import PAPERS, RefineConfig, refine
from tests.crumpled import crumpled

VOXEL = HEIGHT / 16


@pytest.fixture(scope="module")
def meshes() -> np.ndarray:
    """A few folded cloths."""
    return crumpled(3, 0).vertices[:, 2]


def loops(mesh: np.ndarray, voxels: np.ndarray, calls: int) -> tuple[np.ndarray, np.ndarray]:
    """`bounds_of` for the points of one mesh, one point and one column at a time."""
    half = (0.5 - MARGIN) * WIDTH
    tops = {(x, y): int(np.flatnonzero(voxels[x, y]).max()) for x, y in np.ndindex(32, 32) if voxels[x, y].any()}

    def middle(column: tuple[int, int]) -> np.ndarray:
        return (np.array(column) + 0.5) * WIDTH - 1

    def column_of(point: np.ndarray) -> tuple[int, int]:
        x, y = np.clip(np.floor((point[:2] + 1) / WIDTH).astype(int), 0, 31)
        return int(x), int(y)

    points = np.asarray(double(mesh)).reshape(-1, 3)
    low, high = np.full(points.shape, -np.inf), np.full(points.shape, np.inf)
    found, middles = list(tops), np.array([middle(column) for column in tops])
    height: dict[tuple[int, int], float] = {}
    for k, point in enumerate(points):
        column = column_of(point)
        height[column] = max(height.get(column, -np.inf), float(point[2]))
        nearest = found[int(((middles - middle(column)) ** 2).sum(-1).argmin())]
        if nearest != column:
            low[k, :2], high[k, :2] = middle(nearest) - half, middle(nearest) + half
        high[k, 2] = (tops[nearest] + 1) * VOXEL
    lacking = [column for column in tops if height.get(column, -np.inf) < tops[column] * VOXEL]
    # Empty columns first, then those that lack height; the order of empty ones is arbitrary.
    assert len(lacking) <= calls
    for column in lacking:
        target = np.array([*middle(column), (tops[column] + 0.5) * VOXEL])
        called = int(((points - target) ** 2).sum(-1).argmin())
        reach = np.array([half, half, VOXEL / 2])
        low[called], high[called] = target - reach, target + reach
    return low, high


def test_bounds_are_what_loops_over_points_and_columns_give(meshes: np.ndarray) -> None:
    voxels = np.asarray(observe(meshes))
    others = (meshes + np.random.default_rng(0).normal(0, 0.03, meshes.shape)).astype(np.float32)
    calls = 512
    found = bounds_of(jnp.asarray(others), columns(voxels), calls)
    total = unexplained(jnp.asarray(others), found)
    for k, (mesh, volume) in enumerate(zip(others, voxels, strict=True)):
        low, high = loops(mesh, volume, calls)
        # A point that two columns call goes to one of them.
        same = [np.isclose(got[k], wanted, atol=1e-5).all(-1) for got, wanted in zip(found, (low, high), strict=True)]
        assert np.mean(same[0] & same[1]) > 0.99
        points = np.asarray(double(mesh)).reshape(-1, 3)
        low, high = (np.asarray(side[k], float) for side in found)
        beyond = np.where(points < low, low - points, np.where(points > high, points - high, 0))
        assert float(total[k]) == pytest.approx((beyond**2).sum(), rel=1e-4)


def test_of_many_columns_empty_ones_call_first(meshes: np.ndarray) -> None:
    seen = columns(observe(meshes))
    # Half as wide a mesh, so that many columns are empty, and sunk into the table, so that none is covered.
    small = jnp.asarray(meshes) * jnp.array([0.5, 0.5, 1]) - jnp.array([0, 0, 0.1])
    found = bounds_of(small, seen, 16)
    called = np.isfinite(np.asarray(found.low)[..., 2])
    assert (called.sum(axis=1) <= 16).all()
    assert called.any(axis=1).all()
    reached = np.asarray(observe(np.asarray(small))).any(-1)
    for k in range(len(meshes)):
        low = np.asarray(found.low)[k, called[k], :2]
        x, y = np.floor((low + 1) / WIDTH).astype(int).T
        assert not reached[k, x, y].any()


def test_a_mesh_explains_its_own_voxels(meshes: np.ndarray) -> None:
    mesh = jnp.asarray(meshes)
    np.testing.assert_allclose(unexplained(mesh, bounds_of(mesh, columns(observe(meshes)), 64)), 0, atol=1e-9)


def test_gradients_are_finite_where_nothing_was_seen_nearby(meshes: np.ndarray) -> None:
    seen = columns(observe(meshes * np.float32(0.2)))
    mesh = jnp.asarray(SQUARE.flat()[None].repeat(3, 0))
    gradient = jax.grad(lambda mesh: unexplained(mesh, bounds_of(mesh, seen, 8)).sum())(mesh)
    assert np.isfinite(gradient).all()
    assert np.abs(gradient).max() > 0


def test_refined_meshes_explain_more_of_what_was_seen(meshes: np.ndarray) -> None:
    voxels = observe(meshes)
    # An estimate that is shifted, and unsure of it.
    wrong = ProbabilisticMesh(jnp.asarray(meshes) + jnp.array([0.1, 0, 0]), jnp.full(meshes.shape, 0.1))
    plain, told = (
        np.asarray(refine(wrong, wrong.mean, settings, voxels=voxels)) for settings in (PAPERS, RefineConfig())
    )
    before, after = (agreement(mesh, np.asarray(voxels)).silhouette for mesh in (plain, told))
    assert (after > before + 0.05).all()
    assert (after > 0.95).all()
