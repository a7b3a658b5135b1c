"""Physics of the solver, on a 16 x 16 cloth: strain, rest, layers, hands, and independence of the worlds."""

import numpy as np
import pytest

from clothkit.simulation.quality import Quality, measure, reason
from clothkit.simulation.settings import Limits, SimulationConfig
from clothkit.simulation.solver import flat_state
from clothkit.simulation.world import Outcome, Worlds

SIDE = 16
SETTINGS = SimulationConfig(side=SIDE)
NO_HANDS = np.full((1, 2), -1)
HALF_FOLD = (np.array([[0, SIDE - 1]]), np.array([[[0.19, -0.2], [0.19, 0.2]]]))
CORNER_FOLD = (np.array([[0, -1]]), np.array([[[0.1, 0.12], [0.0, 0.0]]]))


def run(states: np.ndarray, grasps: np.ndarray, releases: np.ndarray) -> Outcome:
    return Worlds(len(states), SETTINGS).execute(states, grasps, releases)


@pytest.fixture(scope="module")
def folded() -> Outcome:
    return run(flat_state(SETTINGS)[None], *HALF_FOLD)


@pytest.fixture(scope="module")
def quality(folded: Outcome) -> Quality:
    return measure(folded.states, SETTINGS)


def test_flat_cloth_stays_where_it_is() -> None:
    flat = flat_state(SETTINGS)[None]
    outcome = run(flat, NO_HANDS, np.zeros((1, 2, 2)))
    assert outcome.rested.all()
    np.testing.assert_allclose(outcome.states, flat, atol=1e-4)


def test_half_fold_lies_in_two_layers(folded: Outcome, quality: Quality) -> None:
    x = folded.states[0, ..., 0]
    assert folded.rested[0]
    assert folded.residual_speed[0] <= SETTINGS.settling.rest_speed
    assert np.ptp(x) == pytest.approx(0.2, abs=0.03)
    assert folded.states[0, :4, :, 0].min() > 0.1
    upper, lower = folded.states[0, 1:5, :, 2], folded.states[0, -5:, :, 2]
    assert upper.mean() - lower.mean() == pytest.approx(SETTINGS.material.thickness, rel=0.4)


def test_half_fold_is_sound(folded: Outcome, quality: Quality) -> None:
    assert quality.finite[0]
    assert quality.lowest[0] >= SETTINGS.material.thickness / 2 - 1e-6
    assert quality.strain_p99[0] < 0.03
    assert quality.intersections[0] == 0
    assert quality.gap[0] > 0.5 * SETTINGS.material.thickness
    assert reason(quality, folded, Limits(), 0) == ""


def test_half_fold_stays_folded(folded: Outcome) -> None:
    later = run(folded.states, NO_HANDS, np.zeros((1, 2, 2)))
    assert later.rested.all()
    np.testing.assert_allclose(later.states, folded.states, atol=5e-3)


def test_hands_follow_the_arc() -> None:
    release = np.array([0.05, 0.02])
    worlds = Worlds(1, SETTINGS)
    flat = flat_state(SETTINGS)[None]
    worlds.begin(flat, np.array([[0, -1]]), np.array([[release, [0.0, 0.0]]]))
    start = flat[0, 0, 0].astype(float)
    k = np.hypot(*(release - start[:2]))
    # The circle through (0, 0) and (k, h), centred at height 0, by its perpendicular bisector.
    h = min(0.2 * 0.4 / 1.4, k / 2)
    centre = k / 2 + h**2 / (2 * k)
    sweep = np.pi - np.arctan2(h, k - centre)
    duration = float(worlds.state.move_time.numpy()[0])
    assert duration == pytest.approx(max(centre * sweep / SETTINGS.hand_speed, SETTINGS.shortest_move), rel=1e-5)
    highest = 0.0
    while worlds.state.time.numpy()[0] + 0.11 < duration:
        worlds.advance(1)
        share = float(worlds.state.time.numpy()[0]) / duration
        angle = np.pi - sweep * (3 * share**2 - 2 * share**3)
        along = centre + centre * np.cos(angle)
        expected = start + np.append((release - start[:2]) / k * along, centre * np.sin(angle))
        place = worlds.state.position.numpy()[0, 0]
        np.testing.assert_allclose(place, expected, atol=2e-5)
        highest = max(highest, place[2])
    assert highest > 0.8 * centre


def test_outcome_depends_on_nothing_but_its_own_world(folded: Outcome) -> None:
    flat = flat_state(SETTINGS)[None]
    alone = run(flat, *CORNER_FOLD)
    states = np.concatenate([folded.states, flat, flat])
    grasps = np.concatenate([NO_HANDS, CORNER_FOLD[0], HALF_FOLD[0]])
    releases = np.concatenate([np.zeros((1, 2, 2)), CORNER_FOLD[1], HALF_FOLD[1]])
    worlds = Worlds(4, SETTINGS)
    for _ in range(2):
        together = worlds.execute(states, grasps, releases)
        np.testing.assert_array_equal(together.states[1], alone.states[0])
        np.testing.assert_array_equal(together.states[2], folded.states[0])
        states, grasps, releases = states[[2, 1, 2]], grasps[[2, 1, 2]], releases[[2, 1, 2]]


def test_more_states_than_worlds() -> None:
    with pytest.raises(ValueError, match="2 states for 1 worlds"):
        Worlds(1, SETTINGS).execute(np.zeros((2, SIDE, SIDE, 3), np.float32), NO_HANDS, np.zeros((2, 2, 2)))
