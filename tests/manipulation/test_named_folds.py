"""Named goals as geometry: hands that do what eq. (1) says, and the areas that the folded shapes cover."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.silhouette import silhouette
from clothkit.cloth.topology import SQUARE, Topology, rectangle
from clothkit.manipulation.geometry import release_points
from clothkit.manipulation.named_folds import GOALS, Fold, layout, plane

NAMES = st.sampled_from(sorted(GOALS))
RATIOS = st.one_of(st.none(), st.floats(0.5, 2.0))


def cloth(ratio: float | None) -> Topology:
    """The square, or a rectangle of that ratio."""
    return SQUARE if ratio is None else rectangle(ratio)


MANIPULATIONS = {
    "half": 1,
    "triangle": 1,
    "thirds": 2,
    "quarter": 2,
    "double-triangle": 2,
    "edges-in": 2,
    "one-corner-in": 1,
    "opposite-corners-in": 2,
    "corners-in": 4,
    "corners-and-edges-in": 3,
    "eighth": 3,
}


def test_every_goal_needs_so_many_manipulations() -> None:
    assert {name: goal.manipulations for name, goal in GOALS.items()} == MANIPULATIONS


@given(NAMES, RATIOS)
def test_hands_bring_their_points_where_eq_1_releases_them(name: str, ratio: float | None) -> None:
    """Both hands are on one side of m, and what they hold is mirrored across it."""
    topology = cloth(ratio)
    folds = GOALS[name].folds(topology)
    for number, fold in enumerate(folds):
        uv = np.array(fold.grasps, float)
        before, after = (layout(topology, folds[:count], uv).xy for count in (number, number + 1))
        pair = before[[0, -1]]
        release = release_points(pair, (after - before).mean(0))
        np.testing.assert_allclose(release.points, after[[0, -1]], atol=1e-9)
        assert release.same_side
        point = layout(topology, folds[: number + 1], np.array(fold.point, float)).xy
        np.testing.assert_allclose(point, plane(topology, np.array(fold.image, float)), atol=1e-9)


@given(NAMES, RATIOS, st.integers(0, 10**6))
def test_folding_brings_no_two_points_farther_apart(name: str, ratio: float | None, seed: int) -> None:
    topology = cloth(ratio)
    uv = np.random.default_rng(seed).uniform(-1, 1, (40, 2))
    flat, folded = plane(topology, uv), layout(topology, GOALS[name].folds(topology), uv)
    apart, before = (np.linalg.norm(xy[:, None] - xy, axis=-1) for xy in (folded.xy, flat))
    assert (apart <= before + 1e-9).all()
    np.testing.assert_array_equal(folded.xy[~folded.moved], flat[~folded.moved])


# A triangle with legs of the length of a corner's way in along each edge, twice: it is missing, and lies on the cloth.
CORNER = 0.9**2 / 8
AREAS = {
    "half": 1 / 2,
    "triangle": 1 / 2,
    "thirds": 1 / 3,
    "quarter": 1 / 4,
    "double-triangle": 1 / 4,
    "edges-in": 1 - 2 * 0.9 / 4,
    "one-corner-in": 1 - CORNER,
    "opposite-corners-in": 1 - 2 * CORNER,
    "corners-in": 1 - 4 * CORNER,
    "corners-and-edges-in": 1 - 2 * CORNER - 0.9 / 4,
    "eighth": 1 / 8,
}


@pytest.mark.parametrize("name", GOALS)
def test_of_a_square_the_folded_shape_covers_so_much(name: str) -> None:
    fine = Topology((200, 200), SQUARE.sides)
    xy = layout(fine, GOALS[name].folds(fine)).xy
    covered = silhouette(np.concatenate([xy, np.zeros((200, 200, 1))], axis=-1).astype(np.float32))
    pixel = (2.2 / 256) ** 2
    assert covered.sum() * pixel / 1.4**2 == pytest.approx(AREAS[name], abs=0.02)


def test_of_a_rectangle_the_first_fold_is_across_its_longer_side() -> None:
    towel = rectangle(2.0)
    for name, extent in {"half": (0.7, 0.7), "quarter": (0.7, 0.35), "thirds": (1.4 / 3, 0.7)}.items():
        xy = layout(towel, GOALS[name].folds(towel)).xy
        np.testing.assert_allclose(np.ptp(xy, axis=(0, 1)), extent, atol=0.05)


def test_a_point_on_the_line_stays() -> None:
    found = layout(SQUARE, (Fold(((-1, -1),), (-1, 0), (1, 0)),), np.array([[0.0, 0.3], [-0.1, 0.3]]))
    np.testing.assert_allclose(found.xy, [[0, 0.21], [0.07, 0.21]], atol=1e-12)
    assert found.moved.tolist() == [False, True]
