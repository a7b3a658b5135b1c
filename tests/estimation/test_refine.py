"""Refinement against a plain NumPy loop of the same rule, and what it is for (section 4.7)."""

import jax
import numpy as np
import pytest

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE, Topology, rectangle, square
from clothkit.estimation.refine import RefineConfig, refine, refinement_loss, spring_energy, upward_bias

COARSE = square(8)


def wavy(rng: np.random.Generator, batch: int = 2, topology: Topology = COARSE) -> np.ndarray:
    mesh = np.repeat(topology.flat()[None], batch, axis=0)
    return (mesh + rng.normal(0, 0.03, mesh.shape)).astype(np.float32)


def spring_lengths(mesh: np.ndarray, topology: Topology) -> np.ndarray:
    ends = topology.springs().ends
    vertices = mesh.reshape(-1, 3)
    return np.linalg.norm(vertices[ends[:, 1]] - vertices[ends[:, 0]], axis=-1)


def by_hand(
    mesh: np.ndarray, mean: np.ndarray, std: np.ndarray, settings: RefineConfig, topology: Topology = COARSE
) -> tuple[float, np.ndarray]:
    """Loss and gradient of one mesh in float64, spring by spring."""
    mesh = mesh.astype(float)
    z = (mesh - mean) / std
    loss = (0.5 * z**2 + np.log(std) + 0.5 * np.log(2 * np.pi)).sum()
    gradient = z / std
    vertices, pull = mesh.reshape(-1, 3), np.zeros((mesh.size // 3, 3))
    ends, rest = topology.springs()
    for (a, b), r in zip(ends, rest, strict=True):
        along = vertices[b] - vertices[a]
        length = np.linalg.norm(along)
        loss += settings.spring_weight * (length - r) ** 2
        force = settings.spring_weight * 2 * (length - r) * along / length
        pull[b] += force
        pull[a] -= force
    gradient = gradient + pull.reshape(mesh.shape)
    below = mean[..., 2] - mesh[..., 2]
    loss += settings.upward_weight * np.maximum(0, below).mean()
    gradient[..., 2] -= settings.upward_weight * (below > 0) / below.size
    return loss, gradient


@pytest.mark.parametrize("topology", [COARSE, rectangle(1.6, shape=(8, 8)), Topology((6, 9), (0.5, 1.4))], ids=str)
def test_losses_by_hand(topology: Topology) -> None:
    rng = np.random.default_rng(0)
    mesh, mean = wavy(rng, topology=topology)
    std = rng.uniform(0.02, 0.1, mesh.shape).astype(np.float32)
    settings = RefineConfig()
    estimate = ProbabilisticMesh(mean, std)
    energy = ((spring_lengths(mesh, topology) - topology.springs().rest) ** 2).sum()
    np.testing.assert_allclose(jax.jit(spring_energy, static_argnums=1)(mesh, topology), energy, rtol=1e-4)
    expected = np.maximum(0, mean[..., 2] - mesh[..., 2]).mean()
    np.testing.assert_allclose(jax.jit(upward_bias)(mesh, estimate), expected, rtol=1e-5)
    loss, gradient = by_hand(mesh, mean, std, settings, topology)
    got, slope = jax.jit(jax.value_and_grad(lambda mesh: refinement_loss(mesh, estimate, settings, topology)))(mesh)
    np.testing.assert_allclose(got, loss, rtol=1e-5)
    np.testing.assert_allclose(slope, gradient, rtol=1e-3, atol=0.05)


@pytest.mark.parametrize(("tolerance", "patience", "stops"), [(1e-3, 20, False), (0.3, 3, True)])
def test_matches_a_plain_loop_of_sign_steps(tolerance: float, patience: int, stops: bool) -> None:
    rng = np.random.default_rng(1)
    mesh, mean = wavy(rng)
    std = np.full(mesh.shape, 0.05, np.float32)
    settings = RefineConfig(iterations=12, tolerance=tolerance, patience=patience)
    position, best, lowest = mesh.astype(float), mesh, np.inf
    level, stale = np.inf, 0
    for _ in range(settings.iterations):
        if stale == patience:
            break
        loss, gradient = by_hand(position, mean, std, settings)
        if loss < lowest:
            best, lowest = position.copy(), loss
        # The loss has not stabilised as long as it falls by a share of itself, in one step or in several.
        fell = np.isinf(level) or loss < level - tolerance * abs(level)
        level, stale = (loss, 0) if fell else (level, stale + 1)
        position = position - settings.step * np.sign(gradient)
    assert (stale == patience) == stops
    found = refine(ProbabilisticMesh(mean[None], std[None]), mesh[None], settings, COARSE)[0]
    # A sign near zero may differ between float32 and float64: all but a few coordinates agree.
    assert np.mean(np.abs(found - best) < 1e-5) > 0.97


@pytest.mark.parametrize("topology", [SQUARE, rectangle(1.3), Topology((16, 32), (0.7, 1.4))], ids=str)
def test_recovers_spring_lengths_that_the_estimate_lost(topology: Topology) -> None:
    rng = np.random.default_rng(2)
    mean = topology.flat()[None] * np.float32(0.9)
    std = np.full(mean.shape, 0.1, np.float32)
    start = mean + rng.normal(0, 1e-3, mean.shape).astype(np.float32)
    settings = RefineConfig()
    estimate = ProbabilisticMesh(mean, std)
    found = np.asarray(refine(estimate, start, settings, topology))
    before, after = (by_hand(mesh[0], mean[0], std[0], settings, topology)[0] for mesh in (start, found))
    assert after < before
    rest = topology.springs().rest
    strained, relaxed = (np.abs(spring_lengths(mesh[0], topology) - rest).mean() for mesh in (start, found))
    assert relaxed < 0.3 * strained
    assert np.abs(found).max() < CLOTH_LENGTH


@pytest.mark.parametrize("topology", [SQUARE, rectangle(1.8), rectangle(0.7, shape=(9, 20))], ids=str)
def test_a_flat_cloth_is_without_tension(topology: Topology) -> None:
    assert float(spring_energy(topology.flat(), topology)) == pytest.approx(0, abs=1e-9)


def test_a_mesh_of_another_topology_is_refused() -> None:
    assert float(spring_energy(rectangle(1.8).flat())) > 1
    with pytest.raises(ValueError, match=r"mesh of \(8, 8\) vertices for a topology of \(32, 32\)"):
        spring_energy(COARSE.flat())


def test_upward_bias_lifts_what_lies_below_the_estimate() -> None:
    mean = COARSE.flat()[None]
    # Springs aside, a wide sigma leaves every height as likely as another.
    std = np.full(mean.shape, 10.0, np.float32)
    sunk = mean - np.array([0, 0, 0.02], np.float32)
    settings = RefineConfig(spring_weight=0.0)
    lifted = np.asarray(refine(ProbabilisticMesh(mean, std), sunk, settings, COARSE))
    assert lifted[..., 2].min() > -0.002
    risen = mean + np.array([0, 0, 0.02], np.float32)
    short = RefineConfig(spring_weight=0.0, iterations=10)
    kept = np.asarray(refine(ProbabilisticMesh(mean, std), risen, short, COARSE))
    assert kept[..., 2].min() > 0


@pytest.mark.parametrize("patience", [5, 20])
def test_a_mesh_stops_by_itself_whatever_it_is_batched_with(patience: int) -> None:
    rng = np.random.default_rng(3)
    starts, mean = wavy(rng, 3), wavy(rng, 3)
    std = np.full(mean.shape, 0.02, np.float32)
    starts[0] = mean[0]
    settings = RefineConfig(patience=patience)
    together = np.asarray(refine(ProbabilisticMesh(mean, std), starts, settings, COARSE))
    for i in range(3):
        alone = refine(ProbabilisticMesh(mean[i : i + 1], std[i : i + 1]), starts[i : i + 1], settings, COARSE)
        np.testing.assert_allclose(together[i], alone[0], atol=1e-6)
