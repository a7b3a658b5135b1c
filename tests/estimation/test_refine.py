"""Refinement against a plain NumPy loop of the same rule, and what it is for (section 4.7)."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE, Topology, rectangle, square
from clothkit.estimation.refine import (
    CREASE,
    PAPERS,
    Level,
    RefineConfig,
    bending,
    refine,
    refinement_loss,
    spring_energy,
    upward_bias,
)

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
    settings = PAPERS
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
    settings = replace(PAPERS, iterations=12, tolerance=tolerance, patience=patience)
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
    settings = PAPERS
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
    settings = replace(PAPERS, spring_weight=0.0)
    lifted = np.asarray(refine(ProbabilisticMesh(mean, std), sunk, settings, COARSE))
    assert lifted[..., 2].min() > -0.002
    risen = mean + np.array([0, 0, 0.02], np.float32)
    short = replace(PAPERS, spring_weight=0.0, iterations=10)
    kept = np.asarray(refine(ProbabilisticMesh(mean, std), risen, short, COARSE))
    assert kept[..., 2].min() > 0


@pytest.mark.parametrize("patience", [5, 20])
def test_a_mesh_stops_by_itself_whatever_it_is_batched_with(patience: int) -> None:
    rng = np.random.default_rng(3)
    starts, mean = wavy(rng, 3), wavy(rng, 3)
    std = np.full(mean.shape, 0.02, np.float32)
    starts[0] = mean[0]
    settings = replace(PAPERS, patience=patience)
    together = np.asarray(refine(ProbabilisticMesh(mean, std), starts, settings, COARSE))
    for i in range(3):
        alone = refine(ProbabilisticMesh(mean[i : i + 1], std[i : i + 1]), starts[i : i + 1], settings, COARSE)
        np.testing.assert_allclose(together[i], alone[0], atol=1e-6)


def test_bending_is_the_sum_over_lines_of_vertices() -> None:
    mesh = wavy(np.random.default_rng(4))
    expected = [0.0, 0.0]
    for k, each in enumerate(mesh.astype(float)):
        for lines in (each, each.swapaxes(0, 1)):
            for line in lines:
                for a, b, c in zip(line, line[1:], line[2:], strict=False):
                    expected[k] += np.hypot(np.linalg.norm(a - 2 * b + c), CREASE)
    np.testing.assert_allclose(bending(jnp.asarray(mesh)), expected, rtol=1e-5)


def test_noise_is_smoothed_and_a_crease_stays() -> None:
    roof = SQUARE.flat() * [0.8, 1, 0]
    roof[..., 2] = 0.6 * (0.7 - np.abs(SQUARE.flat()[..., 0]))
    rough = (roof + np.random.default_rng(5).normal(0, 0.01, roof.shape)).astype(np.float32)
    estimate = ProbabilisticMesh(rough[None], np.full((1, *rough.shape), 0.02, np.float32))
    one = replace(PAPERS, spring_weight=0.0, upward_weight=0.0, settle=True, bending_weight=10.0)
    smooth = np.asarray(refine(estimate, rough[None], one))[0]
    away = [np.linalg.norm(mesh - roof, axis=-1) for mesh in (rough, smooth)]
    assert away[1].mean() < 0.8 * away[0].mean()
    assert away[1][15:17].mean() < away[0][15:17].mean()


def test_deviations_above_the_greatest_count_as_that() -> None:
    mesh, mean = wavy(np.random.default_rng(6))
    std = np.where(np.arange(8)[:, None, None] < 4, 0.02, 0.3) * np.ones(mesh.shape)
    bounded = replace(PAPERS, greatest_std=0.1)
    expected = by_hand(mesh, mean, np.minimum(std, 0.1), bounded)[0]
    got = refinement_loss(jnp.asarray(mesh), ProbabilisticMesh(mean, std.astype(np.float32)), bounded, COARSE)
    assert float(got) == pytest.approx(expected, rel=1e-5)


def test_coarse_grids_move_along_and_the_steps_settle() -> None:
    """Two iterations by hand: a whole step, and half of one, of the vertices and of 2 x 2 control points."""
    mesh, mean = wavy(np.random.default_rng(7))
    std = np.full(mesh.shape, 0.05, np.float32)
    settings = replace(PAPERS, coarse=(Level(points=2, stride=3.0),), settle=True, iterations=3)
    share = np.stack([np.linspace(1, 0, 8), np.linspace(0, 1, 8)])
    position, visited = mesh.astype(float), []
    for k in range(3):
        loss, gradient = by_hand(position, mean, std, settings)
        visited.append((loss, position))
        corners = np.sign([[np.tensordot(np.outer(a, b), gradient, 2) for b in share] for a in share])
        spread = sum(np.outer(share[i], share[j])[..., None] * corners[i, j] for i in range(2) for j in range(2))
        position = position - 0.001 * (1 - k / 3) * (np.sign(gradient) + 3 * spread)
    best = min(visited, key=lambda each: each[0])[1]
    found = refine(ProbabilisticMesh(mean[None], std[None]), mesh[None], settings, COARSE)[0]
    assert np.mean(np.abs(found - best) < 1e-5) > 0.97
    assert np.abs(best - mesh).max() > 0.003


def test_springs_that_are_short_count_less() -> None:
    mesh = wavy(np.random.default_rng(8), batch=1)[0]
    beyond = spring_lengths(mesh, COARSE) - COARSE.springs().rest
    assert (beyond < 0).any()
    assert (beyond > 0).any()
    expected = (np.where(beyond < 0, 0.1, 1) * beyond**2).sum()
    assert float(spring_energy(mesh, COARSE, slack_weight=0.1)) == pytest.approx(expected, rel=1e-4)
