"""Orders of layers against cloths that are folded by hand."""

import numpy as np
import pytest

from clothkit.cloth.layers import reversed_share
from clothkit.cloth.topology import SQUARE, Topology, rectangle


def folded(*axes: int, topology: Topology = SQUARE) -> np.ndarray:
    """The flat cloth, its half beyond the middle of each axis in turn laid upside down onto the other."""
    mesh = topology.flat().astype(np.float64).copy()
    for axis in axes:
        over = mesh[..., axis] > 0
        top = mesh[..., 2].max() + 0.01
        mesh[over, axis] *= -1
        mesh[over, 2] = 2 * top - mesh[over, 2]
    return mesh


@pytest.mark.parametrize("topology", [SQUARE, rectangle(1.5), rectangle(0.6, shape=(20, 30))], ids=str)
def test_folding_twice_over_the_other_axis_first_reverses_half_of_the_layers(topology: Topology) -> None:
    one, other = folded(0, 1, topology=topology), folded(1, 0, topology=topology)
    assert reversed_share(one, other, topology) == pytest.approx(0.5, abs=0.05)
    assert reversed_share(one, one, topology) == 0


def test_a_fold_from_below_is_the_other_way_round() -> None:
    below = folded(0) * [1, 1, -1]
    assert reversed_share(folded(0), below) == 1


def test_a_fold_that_is_missing_is_no_other_order() -> None:
    assert np.isnan(reversed_share(folded(0), folded(1, 0)))


def test_where_no_layers_lie_on_one_another_there_is_no_order() -> None:
    assert np.isnan(reversed_share(SQUARE.flat(), SQUARE.flat()))
    assert np.isnan(reversed_share(SQUARE.flat(), folded(0)))
