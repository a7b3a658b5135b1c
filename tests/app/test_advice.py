"""Advice: each sign asks for what helps against it, and for nothing else."""

import numpy as np
import pytest

from clothkit.app.advice import LEAST_UNSURE, LOW_TRUST, Signs, advice, is_flat, simpler_goal, told_of
from clothkit.app.agreement import EstimateAgreement
from clothkit.app.plan_file import UNLIKELY, WORSE
from clothkit.app.plan_parts import UnsurePart
from clothkit.cloth.topology import PAPERS_CLOTH, SQUARE
from clothkit.manipulation.named_folds import GOALS
from clothkit.planning.trust import NEAR
from tests.observation.scenes import folded

GOOD = EstimateAgreement(0.9, 0.8, True, "good")
UNEXPLAINED = EstimateAgreement(0.2, 0.1, False, "unexplained")
STRANGE = EstimateAgreement(0.9, 0.8, True, "strange", 9.0, known=False)
UNKNOWN_CLOTH = EstimateAgreement(0.9, 0.8, True, "too thick", 1.0, known=False, cloth_known=False)


def unsure(share: float, hidden: float = 0.0, unseen: float = 0.0) -> UnsurePart:
    return UnsurePart(
        threshold_m=0.02, share=share, part="edge", centre_m=(0.1, 0.2, 0.0), hidden=hidden, unseen=unseen
    )


@pytest.mark.parametrize(
    ("signs", "asked", "never"),
    [
        (Signs(UNEXPLAINED), ("look at the state again", "mask", "plane", "spread the cloth out"), ("thickness",)),
        (Signs(STRANGE), ("look at the state again", "no hand in view"), ("thickness",)),
        (Signs(GOOD, UNEXPLAINED), ("look at the goal again", "a named one"), ("spread",)),
        (Signs(UNKNOWN_CLOTH), ("sides and thickness", "nets that know such cloths"), ("mask",)),
        (Signs(unsure=unsure(0.3, hidden=0.8)), ("lift or unfold",), ("another side",)),
        (Signs(unsure=unsure(0.3, unseen=0.8)), ("look again from another side",), ("unfold",)),
        (Signs(unsure=unsure(0.3, hidden=0.3)), ("is in view", "spread it out"), ("another side",)),
        (Signs(trust=0.2, steps=2), ("first step alone", "--after", "unfold the cloth first", "fewer folds"), ()),
        (Signs(trust=0.2, steps=1, flat=True), ("fewer folds",), ("first step", "unfold")),
        (Signs(trust=0.2, steps=2, flat=True, named="quarter"), ("fold half first",), ("unfold", "fewer")),
        (Signs(trust=0.2, steps=2, named="thirds"), ("unfold the cloth first", "fewer folds"), ()),
        (Signs(trust=0.2, steps=1, named="half"), ("unfold the cloth first",), ("fewer", "first step")),
        (Signs(trust=0.2, steps=1, named="half", flat=True), ("clothkit simulate",), ("fewer", "unfold")),
        (Signs(warning=WORSE, trust=0.2, steps=2), ("leave the cloth as it lies", "unfold"), ("first step",)),
        (Signs(warning=UNLIKELY, away=NEAR / 2, steps=1), ("leave it as it lies",), ("--seed", "unfold")),
        (Signs(warning=UNLIKELY, away=2 * NEAR, steps=1), ("--seed", "--steps auto", "unfold"), ("leave",)),
        (Signs(warning=UNLIKELY, away=2 * NEAR, steps=3, flat=True), ("--seed",), ("--steps", "unfold")),
    ],
)
def test_a_sign_asks_for_what_helps(signs: Signs, asked: tuple[str, ...], never: tuple[str, ...]) -> None:
    (sentence,) = advice(signs)
    assert all(part in sentence for part in asked)
    assert not any(part in sentence for part in never)


def test_without_a_sign_nothing_is_asked_for() -> None:
    sure = Signs(GOOD, GOOD, unsure(LEAST_UNSURE / 2), trust=LOW_TRUST, away=0.3, steps=3, named="quarter")
    assert advice(sure) == []
    assert advice(Signs()) == []
    # What is poor is told, though it asks for nothing.
    (told,) = told_of(sure)
    assert told == "where 5 % of the cloth lies is unsure (sigma above 20 mm): an edge, around (0.100, 0.200, 0.000) m"
    nowhere = UnsurePart(threshold_m=0.02, share=0, part=None, centre_m=None, hidden=0, unseen=0)
    assert told_of(Signs(GOOD, unsure=nowhere)) == []


def test_several_signs_ask_one_by_one() -> None:
    told = told_of(Signs(UNEXPLAINED, UNEXPLAINED, unsure(0.5, hidden=0.6), trust=0.1, steps=2))
    assert "60 % of this lies beneath another layer" in told[0]
    assert len(told) == 5
    assert all(sentence.startswith("advice: ") for sentence in told[1:])


def test_a_simpler_goal_is_what_the_folds_begin_with() -> None:
    found = {name: simpler_goal(name) for name in GOALS}
    assert (found["quarter"], found["eighth"], found["double-triangle"]) == ("half", "half", "triangle")
    assert (found["corners-in"], found["opposite-corners-in"]) == ("opposite-corners-in", "one-corner-in")
    assert found["half"] is found["triangle"] is found["one-corner-in"] is None


def test_a_cloth_that_covers_its_area_is_flat() -> None:
    assert is_flat(SQUARE.flat(), PAPERS_CLOTH)
    assert not is_flat(folded(along=0.3), PAPERS_CLOTH)
    voxels = np.zeros((32, 32, 16), bool)
    voxels[4:28, 4:28, 0] = True
    assert is_flat(voxels, PAPERS_CLOTH)
    voxels[16:] = False
    assert not is_flat(voxels, PAPERS_CLOTH)
