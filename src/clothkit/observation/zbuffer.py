"""Which triangle is visible at each pixel: a depth buffer that is filled for many triangles at once."""

import itertools

import numpy as np
from jaxtyping import Float, Int

_PAIRS_TOGETHER = 1 << 21
"""Pairs of a triangle and a pixel of its bounding box that are tested in one pass."""
_SLACK = 1e-9


def topmost(
    corners: Float[np.ndarray, "triangles 3 2"], values: Float[np.ndarray, "triangles 3"], shape: tuple[int, int]
) -> tuple[Float[np.ndarray, "rows columns"], Int[np.ndarray, "rows columns"]]:
    """The greatest value at each pixel's centre, and the index of its triangle; -inf and -1 where there is no triangle.

    `corners` are (column, row); pixel (i, j) is centred at row i + 0.5, column j + 0.5. Values must be linear on each
    triangle: heights seen from above without perspective, 1 / depth with perspective.
    """
    rows, columns = shape
    image = np.full(rows * columns, -np.inf)
    owner = np.full(rows * columns, -1)
    first = np.clip(np.ceil(corners.min(1) - 0.5), 0, [columns, rows]).astype(int)
    last = np.clip(np.floor(corners.max(1) - 0.5), -1, [columns - 1, rows - 1]).astype(int)
    width, depth = np.maximum(last - first + 1, 0).T
    pairs = width * depth
    passes = np.cumsum(pairs) // _PAIRS_TOGETHER
    for begin, end in _runs(passes):
        chosen = np.arange(begin, end)[pairs[begin:end] > 0]
        if len(chosen):
            _draw(corners, values, first, width, pairs, chosen, columns, image, owner)
    return image.reshape(shape), owner.reshape(shape)


def _runs(labels: np.ndarray) -> list[tuple[int, int]]:
    """First and last + 1 index of each run of equal labels."""
    cuts = np.flatnonzero(np.diff(labels)) + 1
    edges = [0, *cuts.tolist(), len(labels)]
    return list(itertools.pairwise(edges))


def _draw(
    corners: np.ndarray,
    values: np.ndarray,
    first: np.ndarray,
    width: np.ndarray,
    pairs: np.ndarray,
    chosen: np.ndarray,
    columns: int,
    image: np.ndarray,
    owner: np.ndarray,
) -> None:
    """Draws the chosen triangles into the buffers `image` and `owner`, in place."""
    count = pairs[chosen]
    triangle = np.repeat(chosen, count)
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    row, column = np.divmod(place, width[triangle])
    column, row = column + first[triangle, 0], row + first[triangle, 1]
    a, b, c = (corners[triangle, k] for k in range(3))
    along_b, along_c, offset = b - a, c - a, np.stack([column + 0.5, row + 0.5], -1) - a
    area = _cross(along_b, along_c)
    safe = np.where(area == 0, 1, area)
    weight_b, weight_c = _cross(offset, along_c) / safe, _cross(along_b, offset) / safe
    weight_a = 1 - weight_b - weight_c
    inside = (area != 0) & (np.minimum(np.minimum(weight_a, weight_b), weight_c) >= -_SLACK)
    weights = np.stack([weight_a, weight_b, weight_c], -1)[inside]
    triangle, pixel = triangle[inside], (row * columns + column)[inside]
    value = (weights * values[triangle]).sum(-1)
    # Values are sorted, because of several values for one pixel NumPy keeps the last.
    order = np.argsort(value, kind="stable")
    triangle, pixel, value = triangle[order], pixel[order], value[order]
    seen = value > image[pixel]
    image[pixel[seen]], owner[pixel[seen]] = value[seen], triangle[seen]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
