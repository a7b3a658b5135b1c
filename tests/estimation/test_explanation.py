"""The term that has a mesh explain what was seen, held against a loop over columns and vertices."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import HEIGHT, double, observe
from clothkit.estimation.agreement import agreement
from clothkit.estimation.explanation import MARGIN, WIDTH, columns, pulls, unexplained
from clothkit.estimation.refine import RefineConfig, refine
from tests.crumpled import crumpled

VOXEL = HEIGHT / 16


@pytest.fixture(scope="module")
def meshes() -> np.ndarray:
    """A few folded cloths."""
    return crumpled(3, 0).vertices[:, 2]


def loops(mesh: np.ndarray, voxels: np.ndarray, count: int) -> float:
    """`unexplained` with the `count` columns that are farthest from covered, one column and one vertex at a time."""
    filled = {
        (x, y): (np.flatnonzero(voxels[x, y]).max() + 0.5) * VOXEL
        for x in range(32)
        for y in range(32)
        if voxels[x, y].any()
    }
    half = (0.5 - MARGIN) * WIDTH

    def middle(column: tuple[int, int]) -> np.ndarray:
        return (np.array(column) + 0.5) * WIDTH - 1

    def of(point: np.ndarray) -> tuple[int, int]:
        x, y = np.clip(np.floor((point[:2] + 1) / WIDTH).astype(int), 0, 31)
        return int(x), int(y)

    def beyond(offset: np.ndarray | float, half: float) -> np.ndarray:
        return np.maximum(0, np.abs(offset) - half)

    vertices, total = mesh.reshape(-1, 3), 0.0
    found, middles = list(filled), np.array([middle(column) for column in filled])
    for vertex in vertices:
        home = middle(of(vertex))
        nearest = found[int(((middles - home) ** 2).sum(-1).argmin())]
        total += (beyond(vertex[:2] - middle(nearest), half) ** 2).sum()
        total += max(0.0, vertex[2] - filled[nearest] - VOXEL / 2) ** 2
    reached: dict[tuple[int, int], float] = {}
    for point in np.asarray(double(mesh)).reshape(-1, 3):
        reached[of(point)] = max(reached.get(of(point), -1e9), float(point[2]))
    lacks = {column: top - VOXEL / 2 - reached.get(column, -1e9) for column, top in filled.items()}
    worst = sorted(filled, key=lambda column: (-min(lacks[column], 1.0), column))[:count]
    for column in worst:
        if lacks[column] > 0:
            away = beyond(vertices[:, :2] - middle(column), half)
            vertex = int(np.argmin((away**2).sum(-1) + (vertices[:, 2] - filled[column]) ** 2))
            total += (away[vertex] ** 2).sum() + beyond(vertices[vertex, 2] - filled[column], VOXEL / 2) ** 2
    return float(total)


@pytest.mark.parametrize("count", [4, 64])
def test_it_is_what_loops_over_columns_and_vertices_give(meshes: np.ndarray, count: int) -> None:
    voxels = np.asarray(observe(meshes))
    rng = np.random.default_rng(0)
    others = (meshes + rng.normal(0, 0.03, meshes.shape)).astype(np.float32)
    seen = columns(voxels)
    found = unexplained(jnp.asarray(others), seen, pulls(jnp.asarray(others), seen, count))
    expected = [loops(mesh, volume, count) for mesh, volume in zip(others, voxels, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_a_mesh_explains_its_own_voxels(meshes: np.ndarray) -> None:
    seen = columns(observe(meshes))
    pulled = pulls(jnp.asarray(meshes), seen, 64)
    assert not np.asarray(pulled.active).any()
    # Vertices lie in their columns, if not beyond the margin, and under the tops.
    assert (np.asarray(unexplained(jnp.asarray(meshes), seen, pulled)) <= 1024 * 2 * (MARGIN * WIDTH) ** 2).all()


def test_gradients_are_finite_where_nothing_was_seen_nearby(meshes: np.ndarray) -> None:
    seen = columns(observe(meshes * np.float32(0.2)))
    mesh = jnp.asarray(SQUARE.flat()[None].repeat(3, 0))
    gradient = jax.grad(lambda mesh: unexplained(mesh, seen, pulls(mesh, seen, 8)).sum())(mesh)
    assert np.isfinite(gradient).all()
    assert np.abs(gradient).max() > 0


def test_refined_meshes_explain_more_of_what_was_seen(meshes: np.ndarray) -> None:
    voxels = observe(meshes)
    # An estimate that is shifted, and unsure of it.
    wrong = ProbabilisticMesh(jnp.asarray(meshes) + jnp.array([0.1, 0, 0]), jnp.full(meshes.shape, 0.1))
    plain, told = (
        np.asarray(refine(wrong, wrong.mean, RefineConfig(observed_weight=weight), voxels=voxels))
        for weight in (0.0, 1e4)
    )
    before, after = (agreement(mesh, np.asarray(voxels)).silhouette for mesh in (plain, told))
    assert (after > before + 0.05).all()
    assert (after > 0.9).all()
