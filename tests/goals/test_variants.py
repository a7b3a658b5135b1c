"""Variants are images under the cloth's symmetries, and goals lie as cloths lie."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.mesh import error
from clothkit.cloth.symmetry import relabel
from clothkit.cloth.topology import SQUARE, Topology, rectangle
from clothkit.goals.making import Made
from clothkit.goals.variants import Turn, Variant, angle_of, base, image, lay, placed
from clothkit.manipulation.geometry import to_cartesian
from clothkit.manipulation.named_folds import GOALS, layout

TURNS: tuple[Turn, ...] = (0, 90, 180, 270)
VARIANTS = st.builds(Variant, turn=st.sampled_from(TURNS), mirror=st.booleans())
CLOTHS = st.sampled_from([SQUARE, rectangle(1.6), rectangle(0.7)])


def exact(name: str, topology: Topology) -> Made:
    """The goal folded exactly, each layer above the one before it."""
    folds = GOALS[name].folds(topology)
    states = []
    for number in range(len(folds) + 1):
        ideal = layout(topology, folds[:number])
        states.append(np.concatenate([ideal.xy, 0.01 * ideal.moved[..., None]], axis=-1))
    rng = np.random.default_rng(0)
    manipulations = rng.uniform(-1, 1, (len(folds), 6))
    return Made(np.stack(states).astype(np.float32), manipulations.astype(np.float32))


def matrix(variant: Variant) -> np.ndarray:
    """What a variant does to the plane."""
    turn = np.deg2rad(variant.turn)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return rotation @ np.diag([1, -1 if variant.mirror else 1])


@given(st.sampled_from(sorted(GOALS)), CLOTHS, VARIANTS)
def test_a_variant_is_the_image_of_the_goal(name: str, topology: Topology, variant: Variant) -> None:
    made = exact(name, base(topology, variant))
    found = image(made, variant)
    # The cloth lies as before, in its usual labels.
    np.testing.assert_allclose(found.states[0], topology.flat(), atol=1e-6)
    # And each state is the same surface, mirrored and turned: the same points.
    for before, after in zip(made.states, found.states, strict=True):
        moved = before.copy()
        moved[..., :2] = before[..., :2] @ matrix(variant).T.astype(np.float32)
        ordered = [np.sort(np.round(mesh.reshape(-1, 3), 4).view("f4,f4,f4").ravel()) for mesh in (moved, after)]
        for field in ("f0", "f1", "f2"):
            np.testing.assert_allclose(ordered[0][field], ordered[1][field], atol=2e-4)


@given(CLOTHS, VARIANTS, st.integers(0, 10**6))
def test_its_hands_do_the_same_to_it(topology: Topology, variant: Variant, seed: int) -> None:
    """The grasp points lie on the image where they lay on the goal, and move as the image is turned."""
    made = exact("quarter", base(topology, variant))
    made = made._replace(manipulations=np.random.default_rng(seed).uniform(-1, 1, (2, 6)).astype(np.float32))
    found = image(made, variant)
    for step in range(2):
        for hand in (slice(0, 2), slice(2, 4)):
            before = np.asarray(to_cartesian(made.states[step], made.manipulations[step, hand]))[:2]
            after = np.asarray(to_cartesian(found.states[step], found.manipulations[step, hand]))[:2]
            np.testing.assert_allclose(after, matrix(variant) @ before, atol=1e-5)
        np.testing.assert_allclose(
            found.manipulations[step, 4:], matrix(variant) @ made.manipulations[step, 4:], atol=1e-6
        )


def test_of_a_rectangle_a_quarter_turn_folds_the_other_side() -> None:
    towel, turned = rectangle(1.6), Variant(turn=90)
    halves = {turn: placed(exact("half", base(towel, v)), v) for turn, v in ((0, Variant()), (90, turned))}
    np.testing.assert_allclose(np.ptp(halves[0][..., :2], axis=(0, 1)), [0.7, 0.875], atol=0.03)
    np.testing.assert_allclose(np.ptp(halves[90][..., :2], axis=(0, 1)), [1.4, 0.4375], atol=0.03)


def test_of_a_square_sides_are_told_apart() -> None:
    """Of one-corner-in each corner is another goal, and mirrored it is one of these."""
    made = exact("one-corner-in", SQUARE)
    goals = [placed(made, Variant(turn=turn)) for turn in TURNS]
    for a, b in np.ndindex(4, 4):
        assert (float(error(goals[a], goals[b], aligned=True)) < 1e-3) == (a == b)
    mirrored = placed(made, Variant(mirror=True))
    assert min(float(error(mirrored, goal, aligned=True)) for goal in goals) < 1e-3


@given(CLOTHS, st.floats(-3.1, 3.1), st.integers(0, 7), st.floats(-1, 1), st.floats(-1, 1))
def test_a_cloth_that_lies_turned_is_told_by_how_much(
    topology: Topology, angle: float, k: int, x: float, y: float
) -> None:
    """In any labels, wherever it lies, up to what looks the same."""
    mesh = lay(topology.flat(), angle) + np.array([x, y, 0], np.float32)
    found = angle_of(np.asarray(relabel(mesh, k % topology.count, topology)), topology)
    same = np.pi / 2 if topology.swaps else np.pi
    assert abs(found) <= same / 2 + 1e-6
    off = (found - angle + same / 2) % same - same / 2
    assert off == pytest.approx(0, abs=1e-4)


def test_a_goal_lies_as_the_cloth_lies() -> None:
    made = exact("half", SQUARE)
    plain, turned = placed(made, Variant()), placed(made, Variant(angle=0.3))
    assert float(error(lay(plain, 0.3), turned, aligned=True)) < 5e-3
    assert float(error(plain, turned, aligned=True)) > 0.05


@pytest.mark.parametrize("wrong", [{"turn": 45}, {"angle": 4.0}, {"mirror": 1}])
def test_other_variants_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Variant(**wrong)
