import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.silhouette import centre, centred, iou, silhouette
from clothkit.cloth.topology import SQUARE


def test_the_flat_cloths_silhouette_has_its_area() -> None:
    image = silhouette(SQUARE.flat(), resolution=512)
    pixel = 2.2 / 512
    assert image.sum() * pixel**2 == pytest.approx(1.4**2, rel=0.02)


def test_axis_0_is_x() -> None:
    narrow = SQUARE.flat() * np.float32([0.2, 1, 1])
    image = silhouette(narrow)
    assert image.any(1).sum() < image.any(0).sum()


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_the_centre_moves_with_the_cloth(x: float, y: float) -> None:
    np.testing.assert_allclose(centre(SQUARE.flat() + np.float32([x, y, 0])), [x, y], atol=1e-3)


def test_the_centre_is_the_silhouettes_and_not_the_vertices() -> None:
    folded = SQUARE.flat()
    folded[16:, :, 0] = folded[15::-1, :, 0]
    assert centre(folded)[0] == pytest.approx(-0.35, abs=0.03)
    folded[..., 0] = np.where(folded[..., 0] < -0.6, folded[..., 0], -0.02)
    assert abs(centre(folded)[0] - folded[..., 0].mean()) > 0.1
    folded[..., 2] = np.linspace(0, 0.1, 32)
    moved, was = centred(folded)
    np.testing.assert_allclose(centre(moved), 0, atol=1e-3)
    np.testing.assert_allclose(moved + np.append(was, 0), folded, atol=1e-6)


def test_iou_by_hand() -> None:
    a, b = np.zeros((2, 4, 4), bool)
    assert iou(a, b) == 1
    a[:2], b[1:3] = True, True
    assert iou(a, b) == pytest.approx(4 / 12)
