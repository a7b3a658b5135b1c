"""Where an estimate is poor, by hand: which vertices, which part of the flat cloth, and why it is not seen."""

import numpy as np
import pytest

from clothkit.app.unsure import THRESHOLD, PartName, unsure_part, vertex_sigma
from clothkit.cloth import voxels
from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE
from tests.observation.scenes import folded

LOW, HIGH = 0.5 * THRESHOLD * CLOTH_LENGTH / np.sqrt(3), 2 * THRESHOLD * CLOTH_LENGTH / np.sqrt(3)
"""Along each axis, half of the threshold and twice as much."""


def std_of(mask: np.ndarray) -> np.ndarray:
    return np.where(mask[..., None], HIGH, LOW).repeat(3, axis=-1).astype(np.float32)


def seen(mesh: np.ndarray) -> np.ndarray:
    return np.array(voxels.observe(mesh))


def test_a_vertexs_variance_is_the_sum_of_those_of_its_coordinates() -> None:
    std = np.zeros((32, 32, 3), np.float32)
    std[3, 4] = 0.14 * np.array([2, 3, 6])
    sigma = vertex_sigma(std)
    assert sigma[3, 4] == pytest.approx(0.1 * 7)
    assert np.count_nonzero(sigma) == 1
    assert unsure_part(SQUARE.flat(), np.full_like(std, LOW), seen(SQUARE.flat())) is None


@pytest.mark.parametrize(
    ("part", "u", "v"),
    [
        ("corner", slice(25, 32), slice(0, 7)),
        ("edge", slice(0, 32), slice(26, 32)),
        ("quarter", slice(0, 15), slice(16, 32)),
        ("middle", slice(9, 23), slice(9, 23)),
        ("half", slice(15, 32), slice(0, 32)),
        ("whole", slice(0, 31), slice(1, 32)),
    ],
)
def test_the_part_is_the_one_that_they_are_most_like(part: PartName, u: slice, v: slice) -> None:
    flat, mask = SQUARE.flat(), np.zeros((32, 32), bool)
    mask[u, v] = True
    found = unsure_part(flat, std_of(mask), seen(flat))
    assert found is not None
    assert found.part == part
    assert found.share == pytest.approx(mask.mean())
    # A vertex that is unsure beside the part does not move its middle far.
    np.testing.assert_allclose(found.centre, flat[u, v].mean((0, 1)), atol=0.05)
    assert (found.hidden, found.unseen) == (0, 0)


def test_the_rim_is_all_edges() -> None:
    mask = np.ones((32, 32), bool)
    mask[3:-3, 3:-3] = False
    found = unsure_part(SQUARE.flat(), std_of(mask), seen(SQUARE.flat()))
    assert found is not None
    assert found.part == "rim"


def test_what_lies_beneath_a_fold_is_hidden() -> None:
    """The strip beyond x = 0 lies on the rest, and so hides about as much of that."""
    mesh = folded(along=0.0)
    lower = np.zeros((32, 32), bool)
    lower[4:12] = True
    for mask, hidden in ((lower, 1.0), (lower[::-1], 0.0)):
        found = unsure_part(mesh, std_of(mask), seen(mesh))
        assert found is not None
        assert found.hidden == pytest.approx(hidden, abs=0.02)
        assert found.unseen == 0


def test_what_the_camera_did_not_observe_is_unseen() -> None:
    flat, mask = SQUARE.flat(), np.zeros((32, 32), bool)
    mask[:8, :8] = True
    observed = seen(flat)
    # Voxels are 1/16 wide, and the corner is at -0.7: what lies below -0.3 is covered by a hand.
    observed[:11, :11] = False
    found = unsure_part(flat, std_of(mask), observed)
    assert found is not None
    assert found.unseen > 0.8
    assert found.hidden == 0
    # Beside the viewport nothing is observed either.
    away = unsure_part(flat + np.float32([2, 0, 0]), std_of(mask), seen(flat))
    assert away is not None
    assert away.unseen == 1
