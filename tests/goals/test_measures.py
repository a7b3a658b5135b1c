"""SoftGym's measure, worked out by hand and against its definition by particles of a grid."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.topology import SQUARE, Topology, rectangle, square
from clothkit.goals.measures import groups, softgym
from clothkit.manipulation.named_folds import GOALS, Fold, layout


def test_by_hand() -> None:
    """Four corners. Folded in half, (-1, v) shall lie on (1, v)."""
    corners = square(2)
    flat = corners.flat()
    outcome = flat.copy()
    # The moved ones lie 0.3 and 0.5 beside their partners, of which one has slid on by 0.2.
    outcome[1, 0] += [0.2, 0, 0]
    outcome[0, 0] = outcome[1, 0] + [0, 0.3, 0]
    outcome[0, 1] = outcome[1, 1] + [0, 0.3, 0.4]
    by_hand = ((0.3 + 0.5) / 2 + 1.2 * (0.2 + 0) / 2) / 1.4
    assert softgym(outcome, flat, corners, GOALS["half"].folds(corners)) == pytest.approx(by_hand, rel=1e-5)


@given(st.integers(0, 10**6))
def test_folded_in_half_it_is_that_of_foldcloth(seed: int) -> None:
    """Groups as FoldCloth has them: the first half of the columns, and the others from the last one on."""
    grid = square(8)
    rng = np.random.default_rng(seed)
    flat, outcome = grid.flat(), rng.normal(size=(8, 8, 3)).astype(np.float32)
    numbers = np.arange(64).reshape(8, 8)
    group_a, group_b = numbers[:4].ravel(), np.flip(numbers, axis=0)[:4].ravel()
    position, initial = outcome.reshape(-1, 3), flat.reshape(-1, 3)
    apart = np.linalg.norm(position[group_a] - position[group_b], axis=1).mean()
    away = np.linalg.norm(position[group_b] - initial[group_b], axis=1).mean()
    assert softgym(outcome, flat, grid, GOALS["half"].folds(grid)) == pytest.approx(
        (apart + 1.2 * away) / 1.4, rel=1e-4
    )


@pytest.mark.parametrize("name", GOALS)
@pytest.mark.parametrize("topology", [SQUARE, rectangle(1.6)], ids=["square", "rectangle"])
def test_exactly_folded_it_is_0_and_flat_it_is_not(name: str, topology: Topology) -> None:
    folds = GOALS[name].folds(topology)
    flat = topology.flat()
    folded = np.concatenate([layout(topology, folds).xy, flat[..., 2:]], axis=-1).astype(np.float32)
    # A crease between vertices cuts its corner: partners beside it lie on that.
    assert softgym(folded, flat, topology, folds) < 0.01
    assert softgym(flat, flat, topology, folds) > 0.1


def test_a_goal_that_puts_nothing_on_anything_has_none() -> None:
    away = (Fold(((-1, -1),), point=(-1, 0), image=(3.5, 0)),)
    assert not len(groups(SQUARE, away).moved)
    assert np.isnan(softgym(SQUARE.flat(), SQUARE.flat(), SQUARE, away))
