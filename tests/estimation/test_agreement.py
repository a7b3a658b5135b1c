"""Agreement of estimates with what was seen, counted by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import HEIGHT, Viewport, observe
from clothkit.estimation.agreement import Agreement, AgreementConfig, agreement

VOXEL = HEIGHT / 16


def raised(layers: int) -> np.ndarray:
    """The flat cloth in the middle of the voxels of that layer, of which the lowest is 0."""
    return np.asarray(SQUARE.flat() + np.float32([0, 0, (layers + 0.5) * VOXEL]))


def test_an_estimate_agrees_wholly_with_what_it_looks_like() -> None:
    meshes = np.stack([SQUARE.flat(), raised(3)])
    found = agreement(meshes, np.asarray(observe(meshes)))
    np.testing.assert_array_equal(found.silhouette, [1, 1])
    np.testing.assert_array_equal(found.heights, [1, 1])


@given(st.integers(0, 15), st.integers(0, 15), st.integers(0, 3))
def test_heights_count_voxels_up_to_the_surface(one: int, other: int, forgiven: int) -> None:
    found = agreement(raised(one), np.asarray(observe(raised(other))), forgiven=forgiven)
    low, high = sorted((one, other))
    assert found.silhouette == 1
    assert found.heights == pytest.approx((low + 1) / (max(high - forgiven, low) + 1))


def test_a_surface_at_the_border_of_two_voxels_agrees_in_either() -> None:
    """A towel of 5 mm at a side of 0.5 m: its middle is seen in the second voxel, and estimated in the first."""
    assert agreement(raised(0), np.asarray(observe(raised(1)))).heights == 1
    assert agreement(raised(1), np.asarray(observe(raised(0)))).heights == 1
    assert agreement(raised(0), np.asarray(observe(raised(2)))).heights == pytest.approx(1 / 2)


def test_columns_that_only_one_of_them_has_count_against_it() -> None:
    seen = np.asarray(observe(raised(0)))
    covered = int(seen[..., 0].sum())
    half = seen.copy()
    half[:16] = False
    found = agreement(raised(0), half)
    assert found.silhouette == pytest.approx(half[..., 0].sum() / covered)
    assert found.heights == pytest.approx(found.silhouette)
    nothing = agreement(SQUARE.flat() + np.float32([9, 0, 0]), np.zeros_like(seen))
    assert (float(nothing.silhouette), float(nothing.heights)) == (1, 1)


def test_heights_above_the_viewport_are_clamped_in_both() -> None:
    assert agreement(raised(40), np.asarray(observe(raised(15)))).heights == 1
    low = agreement(
        raised(1),
        np.asarray(observe(raised(1), viewport=Viewport(height=4 * HEIGHT))),
        viewport=Viewport(height=4 * HEIGHT),
    )
    assert low.heights == 1


def test_both_have_to_be_high_enough() -> None:
    least = AgreementConfig(silhouette=0.6, heights=0.3)
    pairs = [(0.6, 0.3), (0.59, 0.9), (0.9, 0.29), (1.0, 1.0)]
    found = Agreement(*(np.array(values) for values in zip(*pairs, strict=True)))
    np.testing.assert_array_equal(found.explains(least), [True, False, False, True])
