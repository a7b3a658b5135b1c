"""Several shapes that voxels may show: merged from views by hand, and learnt from examples."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clothkit.cloth import mesh as meshes
from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.symmetry import relabel
from clothkit.cloth.topology import CLOTH_LENGTH, PAPERS_CLOTH, SQUARE
from clothkit.models.hypotheses import DISTINCT, Hypotheses, merged, most_probable, ordered
from clothkit.models.net import Net
from clothkit.models.settings import VtMConfig
from clothkit.models.vtm import VtM, hypotheses, initial
from clothkit.training.vtm import loss_hypotheses, loss_vtm

FLAT = SQUARE.flat()


def folded(along: int) -> np.ndarray:
    """A quarter of the cloth folded over, along u (0) or along v (1)."""
    mesh = FLAT.copy()
    over = mesh[..., along] > 0.35
    mesh[..., along] = np.where(over, 0.7 - mesh[..., along], mesh[..., along])
    mesh[..., 2] = np.where(over, 0.02, 0.0)
    return mesh


def found(*shapes: tuple[np.ndarray, float], std: float = 0.01) -> Hypotheses:
    """Hypotheses with these means and probabilities, of one observation."""
    mean = np.stack([mesh for mesh, _ in shapes]).astype(np.float32)
    probability = jnp.array([share for _, share in shapes])
    return Hypotheses(ProbabilisticMesh(mean, np.full_like(mean, std)), probability)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 7), st.integers(0, 7), st.floats(0.55, 0.95))
def test_views_in_any_labels_agree_on_two_shapes(k: int, j: int, share: float) -> None:
    # Mirrored along x, which no relabelling undoes: another shape at the same place.
    one, other = folded(0), folded(0) * np.float32([-1, 1, 1])
    assert float(meshes.error(one, other)) > DISTINCT
    views = [
        found((one, share), (other, 1 - share)),
        found((np.asarray(relabel(other, j)), 1 - share), (np.asarray(relabel(one, k)), share)),
    ]
    mesh, probability = merged(views, 2)
    np.testing.assert_allclose(probability, [share, 1 - share], atol=1e-6)
    for mean, truth in zip(mesh.mean, (one, other), strict=True):
        assert float(meshes.error(mean, truth)) < 1e-6
    np.testing.assert_allclose(mesh.std, 0.01, atol=1e-6)


def test_near_meshes_are_one_shape_with_the_mixtures_moments() -> None:
    near = folded(0) + np.float32([0.02, 0, 0])
    mesh, probability = merged([found((folded(0), 1.0)), found((near, 1.0))], 2)
    np.testing.assert_allclose(probability, [1, 0])
    np.testing.assert_allclose(mesh.mean[0], folded(0) + np.float32([0.01, 0, 0]), atol=1e-6)
    np.testing.assert_allclose(mesh.std[0, ..., 0], np.hypot(0.01, 0.01), rtol=1e-4)
    np.testing.assert_allclose(mesh.std[0, ..., 2], 0.01, rtol=1e-4)


def test_the_sides_of_a_rectangle_are_not_swapped() -> None:
    """A mesh with u along the long side is no near one of a mesh with u along the short side."""
    cloth = np.float32([CLOTH_LENGTH, CLOTH_LENGTH / 1.5, 0.007])
    mesh = FLAT * np.float32([1, 1 / 1.5, 1])
    swapped = np.asarray(mesh.swapaxes(0, 1))
    _, of_square = merged([found((mesh, 1.0)), found((swapped, 1.0))], 2)
    _, of_rectangle = merged([found((mesh, 1.0)), found((swapped, 1.0))], 2, cloth)
    np.testing.assert_allclose(of_square, [1, 0])
    np.testing.assert_allclose(of_rectangle, [0.5, 0.5])


def test_order_is_by_probability() -> None:
    first, second = folded(0), folded(1)
    mesh, probability = ordered(found((first, 0.2), (second, 0.8)))
    np.testing.assert_allclose(probability, [0.8, 0.2])
    np.testing.assert_array_equal(mesh.mean, np.stack([second, first]))
    np.testing.assert_array_equal(most_probable(Hypotheses(mesh, probability)).mean, second)


def test_the_nearest_hypothesis_is_what_learns() -> None:
    truth = jnp.asarray(folded(0)[None])
    mean = jnp.stack([truth + 0.02, truth.at[..., 0].multiply(-1)], axis=1)
    # The far one is more likely, since it is less sure.
    std = jnp.stack([jnp.full(truth.shape, 0.001), jnp.full(truth.shape, 0.5)], axis=1)
    batch = Hypotheses(ProbabilisticMesh(mean, std), jnp.array([[0.3, 0.7]]))
    each = [float(loss_vtm(truth, ProbabilisticMesh(mean[:, i], std[:, i]))[0]) for i in (0, 1)]
    assert each[0] > each[1]
    wanted = 0.95 * each[0] + 0.05 * np.mean(each) - 0.01 * np.log(0.3)
    assert float(loss_hypotheses(truth, batch)[0]) == pytest.approx(wanted, rel=1e-4)


def test_a_net_learns_both_shapes_that_look_the_same_and_how_often_each_occurs() -> None:
    config, seen = VtMConfig(hidden=16, hypotheses=2), jnp.zeros((8, 32, 32, 16)).at[:, 8:24, 8:24, 0].set(1)
    net, params = VtM(config), initial(config, key=jax.random.key(0))
    shapes, optimiser = jnp.stack([folded(0), folded(0) * np.float32([-1, 1, 1])]), optax.adam(1e-2)

    @jax.jit
    def step(params, state, key):
        truth = shapes[jax.random.bernoulli(key, 0.25, (8,)).astype(int)]
        gradient = jax.grad(lambda p: loss_hypotheses(truth, net.apply({"params": p}, seen)).mean())(params)
        updates, state = optimiser.update(gradient, state)
        return optax.apply_updates(params, updates), state

    state = optimiser.init(params)
    for key in jax.random.split(jax.random.key(1), 300):
        params, state = step(params, state, key)
    # Probabilities follow the last few batches of eight.
    mesh, probability = hypotheses(Net(config, params), seen[:1], PAPERS_CLOTH)
    np.testing.assert_allclose(probability[0], [0.75, 0.25], atol=0.2)
    for mean, shape in zip(mesh.mean[0], shapes, strict=True):
        assert float(meshes.error(mean, shape)) < 0.03
