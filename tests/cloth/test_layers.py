"""Orders of layers against cloths that are folded by hand."""

import numpy as np
import pytest

from clothkit.cloth.grid import flat
from clothkit.cloth.layers import reversed_share


def folded(*axes: int) -> np.ndarray:
    """The flat cloth, its half beyond the middle of each axis in turn laid upside down onto the other."""
    mesh = flat().astype(np.float64).copy()
    for axis in axes:
        over = mesh[..., axis] > 0
        top = mesh[..., 2].max() + 0.01
        mesh[over, axis] *= -1
        mesh[over, 2] = 2 * top - mesh[over, 2]
    return mesh


def test_folding_twice_over_the_other_axis_first_reverses_half_of_the_layers() -> None:
    assert reversed_share(folded(0, 1), folded(1, 0)) == pytest.approx(0.5, abs=0.05)
    assert reversed_share(folded(0, 1), folded(0, 1)) == 0


def test_a_fold_from_below_is_the_other_way_round() -> None:
    below = folded(0) * [1, 1, -1]
    assert reversed_share(folded(0), below) == 1


def test_a_fold_that_is_missing_is_no_other_order() -> None:
    assert np.isnan(reversed_share(folded(0), folded(1, 0)))


def test_where_no_layers_lie_on_one_another_there_is_no_order() -> None:
    assert np.isnan(reversed_share(flat(), flat()))
    assert np.isnan(reversed_share(flat(), folded(0)))
