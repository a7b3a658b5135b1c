"""The guard against tangles: what it counts, and that a world which went back ends without crossings."""

from collections.abc import Callable

import numpy as np
import pytest
import warp as wp

from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.manipulation.candidates import CandidateConfig
from clothkit.manipulation.sampling import SamplingConfig, draw_hands, sample
from clothkit.simulation.executor import perform
from clothkit.simulation.kernels.crossings import count_crossings
from clothkit.simulation.kernels.edges import list_pairs
from clothkit.simulation.kernels.faces import list_contacts
from clothkit.simulation.kernels.state import Solver, State
from clothkit.simulation.quality import intersections
from clothkit.simulation.settings import SimulationConfig
from clothkit.simulation.solver import flat_state
from clothkit.simulation.world import Motion, Worlds

SETTINGS = SimulationConfig()
NEVER = 1e9  # s, m
Fold = tuple[np.ndarray, np.ndarray, np.ndarray]


@wp.kernel
def count(solver: Solver, state: State, found: wp.array(dtype=int)):  # type: ignore[valid-type]
    """Count each world's crossings, by lists made from its positions."""
    w = wp.tid()
    list_contacts(solver, state, w)
    list_pairs(solver, state, w, False)
    found[w] = count_crossings(solver, state, w)


def crossings(states: np.ndarray) -> np.ndarray:
    """What the guard counts."""
    worlds = Worlds(len(states), SETTINGS)
    nothing = Motion(np.full((len(states), 2, 1), -1), np.zeros((len(states), 2, 2, 3)), np.ones(len(states)))
    worlds.begin(states, nothing)
    found = wp.zeros(len(states), dtype=int)
    wp.launch(count, dim=len(states), inputs=[worlds.solver, worlds.state, found])
    return found.numpy()


def test_the_guard_counts_what_inspection_counts() -> None:
    """On cloths doubled at random and then shaken, so that their layers pierce each other here and there."""
    flat = flat_state(SETTINGS)
    states = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        direction, place = rng.normal(size=2), rng.uniform(-0.05, 0.05)
        direction /= np.linalg.norm(direction)
        beyond = np.maximum(flat[..., :2] @ direction - place, 0)
        state = flat.copy()
        state[..., :2] -= 2 * beyond[..., None] * direction
        state[..., 2] += np.where(beyond > 0, SETTINGS.material.thickness, 0)
        states.append(state + rng.normal(size=state.shape) * [3e-4, 3e-4, 1e-3 * (seed > 0)])
    shaken = np.stack(states).astype(np.float32)
    expected = intersections(shaken)
    assert (expected[1:] > 10).all()
    np.testing.assert_array_equal(crossings(shaken), expected)


def test_no_crossings_in_a_flat_cloth() -> None:
    assert crossings(flat_state(SETTINGS)[None]).tolist() == [0]


def fold(states: np.ndarray, change: Callable[[Solver], None]) -> Fold:
    """Outcomes, returns and crossings let be, of random folds by a solver with changed settings."""
    scale = SETTINGS.cloth_side / CLOTH_LENGTH
    drawn = []
    for seed, state in enumerate(states):
        rng = np.random.default_rng(seed)
        hands = draw_hands(rng, SamplingConfig())
        drawn.append(sample(rng, state / np.float32(scale), hands, SamplingConfig(), CandidateConfig()))
    worlds = Worlds(len(drawn), SETTINGS)
    change(worlds.solver)
    _, outcome = perform(
        worlds,
        states,
        np.array([state.reshape(-1, 3)[list(draw.vertices), :2] for state, draw in zip(states, drawn, strict=True)]),
        np.array([draw.displacement for draw in drawn]) * scale,
        np.array([draw.single for draw in drawn]),
    )
    return outcome.states, worlds.read("returns", len(drawn)), worlds.read("lost", len(drawn))


@pytest.fixture(scope="module")
def once() -> Fold:
    """Ten cloths, folded once as usual."""
    return fold(np.stack([flat_state(SETTINGS)] * 10), lambda solver: None)


def unwatched(solver: Solver) -> None:
    """No edge within the cloth is watched: they cross others at will."""
    solver.bend_u.feature = solver.bend_v.feature = solver.twist_feature = NEVER


def unguarded(solver: Solver) -> None:
    """The same without guard."""
    unwatched(solver)
    solver.guard_interval = NEVER


def test_a_world_that_went_back_has_no_crossings(once: Fold) -> None:
    """With unwatched edges second folds tangle: the guard undoes that, or says how many crossings it has let be."""
    tangled, returns, _ = fold(once[0], unguarded)
    without = intersections(tangled)
    assert not returns.any()
    assert (without > 0).sum() >= 2
    states, returns, lost = fold(once[0], unwatched)
    crossed = intersections(states)
    undone = (returns > 0) & (lost == 0)
    assert undone.any()
    assert (crossed[lost == 0] == 0).all()
    assert crossed.sum() < without.sum() / 2


def test_folds_whose_edges_are_watched_have_none(once: Fold) -> None:
    states, _, lost = once
    assert intersections(states).tolist() == [0] * len(states) == lost.tolist()
