"""The measures of a state, against brute force in NumPy."""

import numpy as np
import pytest
from scipy.optimize import minimize

from clothkit.cloth.topology import Topology, edges, rectangle, square, triangles
from clothkit.simulation.quality import Quality, gaps, intersections, measure, reason
from clothkit.simulation.settings import SimulateConfig, SimulationConfig
from clothkit.simulation.solver import flat_state
from clothkit.simulation.world import Outcome

SETTINGS = SimulationConfig(side=8)


def crumpled(seed: int, topology: Topology) -> np.ndarray:
    """A grid with smooth noise large enough to tangle it."""
    rng = np.random.default_rng(seed)
    grid = flat_state(SETTINGS, topology)
    steps = rng.normal(size=(2, *topology.shape, 3)) * 0.3 * 0.4 / (max(topology.shape) - 1)
    return (grid * 0.4 + steps[0].cumsum(0) + steps[1].cumsum(1)).astype(np.float32)


def pierced_pairs(mesh: np.ndarray) -> int:
    """Pairs of edge and triangle: solve for the crossing of line and plane, then for barycentric coordinates."""
    x = mesh.reshape(-1, 3).astype(float)
    count = 0
    for i, j in edges(mesh.shape[:2]):
        for a, b, c in triangles(mesh.shape[:2]):
            if {i, j} & {a, b, c}:
                continue
            matrix = np.stack([x[j] - x[i], x[a] - x[b], x[a] - x[c]], axis=1)
            t, fb, fc = np.linalg.solve(matrix, x[a] - x[i])
            count += 0 < t < 1 and fb > 0 and fc > 0 and fb + fc < 1
    return count


@pytest.mark.parametrize(("seed", "topology"), [(0, square(8)), (1, square(8)), (2, rectangle(1.5, shape=(9, 7)))])
def test_intersections_by_brute_force(seed: int, topology: Topology) -> None:
    mesh = crumpled(seed, topology)
    expected = pierced_pairs(mesh)
    assert expected > 0
    assert intersections(mesh[None])[0] == expected


def test_one_vertex_through_the_cloth() -> None:
    mesh = flat_state(SETTINGS)
    middle = mesh[3:5, 3:5, :2].mean((0, 1))
    mesh[0, 0] = [middle[0] + 0.01, middle[1] - 0.005, -0.02]
    mesh[0, 1] = mesh[1, 0] = mesh[1, 1] = mesh[4, 4] + [0.0, 0.0, 0.03]
    mesh[0, 1, 0] -= 0.001
    mesh[1, 0, 1] += 0.001
    mesh += np.random.default_rng(0).normal(size=mesh.shape).astype(np.float32) * np.float32(1e-5)
    assert intersections(mesh[None])[0] == pierced_pairs(mesh) > 0


def test_flat_cloth_has_none() -> None:
    assert intersections(flat_state(SETTINGS)[None])[0] == 0


@pytest.mark.parametrize("topology", [square(8), rectangle(1.5, shape=(9, 6))])
def test_gaps_by_minimisation(topology: Topology) -> None:
    mesh = crumpled(5, topology)
    n = topology.shape[1]
    x = mesh.reshape(-1, 3).astype(float)
    best = np.inf
    for i in range(len(x)):
        for corners in topology.triangles():
            if any(max(abs(i // n - k // n), abs(i % n - k % n)) <= 2 for k in corners):
                continue
            a, b, c = x[corners]
            best = min(best, distance(x[i], a, b, c, best))
    assert gaps(mesh[None], reach=1.0)[0] == pytest.approx(best, abs=1e-6)


def distance(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, best: float) -> float:
    if np.linalg.norm(np.clip(p, np.minimum(a, np.minimum(b, c)), np.maximum(a, np.maximum(b, c))) - p) > best:
        return np.inf
    scale = 1e3  # the minimiser works in millimetres

    def squared(f: np.ndarray) -> float:
        return float((((a + f[0] * (b - a) + f[1] * (c - a) - p) * scale) ** 2).sum())

    inside = {"type": "ineq", "fun": lambda f: 1 - f[0] - f[1]}
    found = minimize(
        squared, [0.3, 0.3], bounds=[(0, 1), (0, 1)], constraints=[inside], method="SLSQP", options={"ftol": 1e-12}
    )
    return float(np.sqrt(found.fun)) / scale


def test_gaps_are_measured_up_to_their_reach() -> None:
    assert gaps(flat_state(SETTINGS)[None], reach=0.01)[0] == pytest.approx(0.01)


def test_measures_of_a_stretched_cloth() -> None:
    mesh = flat_state(SETTINGS)
    mesh[..., 0] *= 1.1
    mesh[2, 3, 2] = 0.02
    found = measure(mesh[None], SETTINGS)
    spacing = 0.4 / 7
    assert found.height[0] == pytest.approx(0.02 * 3.5)
    assert found.lowest[0] == pytest.approx(0.001)
    assert found.strain_p99[0] > 0.09
    assert found.strain_worst[0] == pytest.approx(np.hypot(1.1 * spacing, 0.019) / spacing - 1, rel=1e-4)


def test_reasons() -> None:
    def rejected(*, spent: bool = False, **changes: float) -> str:
        values = {
            "finite": True, "lowest": 0.001, "height": 0.1, "strain_p99": 0.02, "strain_worst": 0.1,
            "intersections": 0, "gap": 0.001,
        }  # fmt: skip
        quality = Quality(**{name: np.array([changes.get(name, value)]) for name, value in values.items()})
        speed = np.array([changes.get("speed", 0.001)])
        outcome = Outcome(np.zeros((1, 2, 2, 3), np.float32), np.array([True]), speed, np.zeros(1), np.array([spent]))
        return reason(quality, outcome, SimulateConfig(sequences=1), 0)

    assert rejected() == ""
    assert rejected(finite=False) == "not finite"
    assert rejected(spent=True) == "out of steps"
    assert rejected(speed=0.02) == "not at rest"
    assert rejected(lowest=-0.001) == "below table"
    assert rejected(intersections=1) == "intersections"
    assert rejected(gap=0.49 * SETTINGS.material.thickness) == "layers too close"
    assert rejected(height=0.13) == "too high"
    assert rejected(strain_p99=0.1) == rejected(strain_worst=0.4) == "strained"


def test_a_state_that_is_not_finite() -> None:
    mesh = flat_state(SETTINGS)
    mesh[1, 1, 1] = np.nan
    assert not measure(mesh[None], SETTINGS).finite[0]


def test_strains_are_those_of_each_direction_of_a_rectangle() -> None:
    """Its spacings differ: 0.4 m over 9 rows and 0.2 m over 11 columns."""
    topology = rectangle(2.0, shape=(9, 11))
    mesh = flat_state(SETTINGS, topology)
    assert measure(mesh[None], SETTINGS, topology).strain_worst[0] == pytest.approx(0, abs=1e-5)
    mesh[-1, :, 0] += 0.005
    assert measure(mesh[None], SETTINGS, topology).strain_worst[0] == pytest.approx(0.005 / (0.4 / 8), rel=1e-4)
    mesh[-1, :, 0] -= 0.005
    mesh[:, 0, 1] -= 0.003
    assert measure(mesh[None], SETTINGS, topology).strain_worst[0] == pytest.approx(0.003 / (0.2 / 10), rel=1e-4)


def strip(angle: float, *, within: bool) -> np.ndarray:
    """A strip of cloth of five edges along u, bent by an angle: within the middle edge, or at the vertex before it."""
    spacing = SETTINGS.cloth_side / 5
    turns = np.array([0, 0, 0.5, 1, 1]) if within else np.array([0, 0, 1, 1, 1])
    directions = np.stack([np.cos(angle * turns), 0 * turns, np.sin(angle * turns)], axis=-1)
    lengths = np.array([1, 1, np.cos(angle / 2) if within else 1, 1, 1])
    line = np.concatenate([np.zeros((1, 3)), np.cumsum(spacing * lengths[:, None] * directions, axis=0)])
    across = np.linspace(0, SETTINGS.cloth_side, 8)
    return (line[:, None] + across[:, None] * [0, 1, 0]).astype(np.float32)


@pytest.mark.parametrize("angle", [0.3, 1.2, 2.4])
@pytest.mark.parametrize("within", [True, False])
def test_a_bent_thread_is_not_strained(angle: float, within: bool) -> None:
    mesh = strip(angle, within=within)
    found = measure(mesh[None], SETTINGS, rectangle(1.0, shape=mesh.shape[:2]))
    np.testing.assert_allclose(found.strain_worst, 0, atol=1e-5)


def test_a_shortened_straight_edge_is_strained() -> None:
    mesh = strip(0.0, within=True)
    mesh[3:, :, 0] -= 0.05 * SETTINGS.cloth_side / 5
    found = measure(mesh[None], SETTINGS, rectangle(1.0, shape=mesh.shape[:2]))
    np.testing.assert_allclose(found.strain_worst, 0.05, rtol=1e-4)
