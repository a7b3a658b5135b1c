"""Goals in the simulator: clean, of the size that they shall have, and with the points together that shall meet."""

import dataclasses

import numpy as np
import pytest

from clothkit.cloth.silhouette import centred, silhouette
from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE, Topology, rectangle, square
from clothkit.goals import making
from clothkit.goals.making import Made, careful, make, rigid
from clothkit.manipulation.named_folds import GOALS, Fold, Goal, layout
from clothkit.manipulation.vector import is_single
from clothkit.runtime.errors import InputError
from clothkit.simulation.quality import intersections
from clothkit.simulation.settings import Settling, SimulationConfig

COARSE = SimulationConfig(side=17, time_step=2e-3)
COARSE_CLOTH = square(17)
THICKNESS = COARSE.material.thickness / COARSE.cloth_side
SPACING = 1 / 16
"""Both in cloth lengths."""


def apart(made: Made, name: str, topology: Topology) -> np.ndarray:
    """How far in x and y the vertices that are moved lie from their places [cloth length]."""
    ideal, goal = layout(topology, GOALS[name].folds(topology)), made.states[-1][..., :2]
    turn, shift = rigid(ideal.xy[~ideal.moved], goal[~ideal.moved].astype(float))
    return np.linalg.norm(ideal.xy @ turn.T + shift - goal, axis=-1)[ideal.moved] / CLOTH_LENGTH


@pytest.fixture(scope="module")
def half() -> Made:
    return make(GOALS["half"], COARSE_CLOTH, COARSE)


def test_a_half_covers_half(half: Made) -> None:
    flat, goal = (silhouette(centred(half.states[state])[0]).sum() for state in (0, 1))
    assert goal / flat == pytest.approx(0.5, abs=SPACING / 2)


def test_what_shall_meet_does(half: Made) -> None:
    """Within a few thicknesses, away from the crease, which is round."""
    pairs = half.states[1, :6] - half.states[1, :-7:-1]
    assert np.linalg.norm(pairs, axis=-1).max() / CLOTH_LENGTH < 4 * THICKNESS
    assert (pairs[..., 2] > 0).all()
    assert apart(half, "half", COARSE_CLOTH).mean() < 3 * THICKNESS


def test_it_is_clean_and_tells_its_manipulations(half: Made) -> None:
    metres = half.states * np.float32(COARSE.cloth_side / CLOTH_LENGTH)
    assert intersections(metres).tolist() == [0, 0]
    assert half.manipulations.shape == (1, 6)
    assert half.manipulations[0, :4].tolist() == [-1, -1, -1, 1]
    # What is let go slides on, so the hands go less far than the edge.
    assert 0.8 * 1.4 < half.manipulations[0, 4] < 1.4
    assert abs(half.manipulations[0, 5]) < 0.02


def test_one_hand_does_where_one_is_enough() -> None:
    towel = rectangle(1.5, shape=(17, 17))
    made = make(GOALS["opposite-corners-in"], towel, COARSE)
    assert is_single(made.manipulations).all()
    assert apart(made, "opposite-corners-in", towel).mean() < SPACING


def test_too_narrow_a_cloth_is_refused() -> None:
    with pytest.raises(
        InputError, match=r"goal one-corner-in, fold 1: moves the cloth by 0.2\d cloth lengths, expected"
    ):
        make(GOALS["one-corner-in"], rectangle(3.0, shape=(17, 17)), COARSE)


def test_what_never_rests_is_refused() -> None:
    hasty = dataclasses.replace(COARSE, settling=Settling(longest=0.1))
    with pytest.raises(InputError, match=r"goal half, fold 1: no try left this cloth clean \(not at rest"):
        make(GOALS["half"], COARSE_CLOTH, hasty)


def test_what_does_not_come_about_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(making, "MOST", 1e-4)
    with pytest.raises(InputError, match=r"goal half, fold 1: the closest try is 0.0\d cloth lengths off, expected"):
        make(GOALS["half"], COARSE_CLOTH, COARSE)


def test_other_grasps_are_tried_where_the_first_ones_do_not_do() -> None:
    """Of a fold with grasps in the middle of the edge and at its ends, these: they leave no sagging corners."""
    poor = Fold(((-1.0, 0.0),), (-1.0, 0.0), (1.0, 0.0), others=(((-1.0, -1.0), (-1.0, 1.0)),))
    goal = Goal("half", "", "", lambda _: (poor,))
    made = make(goal, COARSE_CLOTH, COARSE)
    assert made.manipulations[0, :4].tolist() == [-1, -1, -1, 1]


def test_hands_are_slow_and_grasp_all_layers() -> None:
    slow = careful(SimulationConfig(hand_speed=0.1))
    assert (slow.hand_speed, slow.grasp) == (0.1, "all")
    assert careful(SimulationConfig()).hand_speed < SimulationConfig().hand_speed


def test_the_nearest_rotation_and_shift() -> None:
    points = SQUARE.flat()[..., :2].reshape(-1, 2).astype(float)
    expected = np.array([[np.cos(2.0), -np.sin(2.0)], [np.sin(2.0), np.cos(2.0)]])
    turn, shift = rigid(points, points @ expected.T + [0.1, -0.3])
    np.testing.assert_allclose(turn, expected, atol=1e-9)
    np.testing.assert_allclose(shift, [0.1, -0.3], atol=1e-9)
