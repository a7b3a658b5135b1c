"""Statistics of a feature's values, gathered part by part, so that a dataset need not fit into memory.

Means and sums of squared deviations of parts are joined by the formulas of Chan, Golub and LeVeque (1979), "Updating
formulae and a pairwise algorithm for computing sample variances".
"""

from collections.abc import Sequence

import cv2
import numpy as np
import pyarrow as pa
from jaxtyping import Shaped, UInt8

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_BLOCK = 256  # places whose values are float64 at a time


class OfValues:
    """Statistics of numbers, `width` of them in each frame."""

    def __init__(self, width: int) -> None:
        self._width, self._count = width, 0
        self._least, self._most = np.full(width, np.inf), np.full(width, -np.inf)
        self._mean, self._squares = np.zeros(width), np.zeros(width)
        self._sampled: list[np.ndarray] = []

    def add(self, columns: Sequence[pa.ChunkedArray], sampled: Sequence[pa.ChunkedArray] = ()) -> None:
        """Add frames; quantiles are those of the `sampled` ones, which are kept in memory."""
        values = self._values(columns)
        count, before = len(values), self._count
        self._count += count
        for block in self._blocks():
            part = values[:, block].astype(np.float64)
            mean = part.mean(0)
            apart = mean - self._mean[block]
            self._squares[block] += ((part - mean) ** 2).sum(0) + apart**2 * (before * count / self._count)
            self._mean[block] = mean if not before else self._mean[block] + apart * (count / self._count)
            self._least[block] = np.minimum(self._least[block], part.min(0))
            self._most[block] = np.maximum(self._most[block], part.max(0))
        if sampled:
            self._sampled.append(self._values(sampled))

    def found(self) -> dict[str, np.ndarray]:
        """The statistics of what was added, with quantiles if frames were sampled."""
        std = np.sqrt(self._squares / self._count)
        found = {"min": self._least, "max": self._most, "mean": self._mean, "std": std}
        if self._sampled:
            values, shares = np.concatenate(self._sampled), list(QUANTILES.values())
            blocks = [np.quantile(values[:, own].astype(np.float64), shares, axis=0) for own in self._blocks()]
            found |= dict(zip(QUANTILES, np.concatenate(blocks, axis=1), strict=True))
        return {**found, "count": np.array([self._count])}

    def _blocks(self) -> list[slice]:
        return [slice(first, first + _BLOCK) for first in range(0, self._width, _BLOCK)]

    def _values(self, columns: Sequence[pa.ChunkedArray]) -> Shaped[np.ndarray, "frame place"]:
        chunks = [chunk.flatten() if self._width > 1 else chunk for column in columns for chunk in column.chunks]
        found = np.concatenate([chunk.to_numpy(zero_copy_only=False) for chunk in chunks])
        return found.reshape(-1, self._width)


class OfPictures:
    """Statistics over all pixels of a channel, of values 0..1; quantiles are of all frames."""

    def __init__(self) -> None:
        self._count, self._pixels, self._quantiles = 0, np.zeros((3, 256), np.int64), False

    def add(self, columns: Sequence[pa.ChunkedArray], sampled: Sequence[pa.ChunkedArray] = ()) -> None:
        """Add frames; with any `sampled` ones, quantiles are told."""
        self._quantiles |= bool(sampled)
        for column in columns:
            self._count += len(column)
            for png in column:
                picture = decoded(png["bytes"].as_py())
                self._pixels += np.stack([np.bincount(picture[..., k].ravel(), minlength=256) for k in range(3)])

    def found(self) -> dict[str, np.ndarray]:
        """The statistics of what was added, [channel 1 1] each but for the count of frames."""
        levels, share = np.arange(256) / 255, self._pixels / self._pixels.sum(1, keepdims=True)
        mean = share @ levels
        found = {
            "min": np.array([levels[np.flatnonzero(row)[0]] for row in self._pixels]),
            "max": np.array([levels[np.flatnonzero(row)[-1]] for row in self._pixels]),
            "mean": mean,
            "std": np.sqrt(np.maximum(share @ levels**2 - mean**2, 0)),
        }
        if self._quantiles:
            below = np.cumsum(share, axis=1)
            found |= {
                name: np.array([levels[np.searchsorted(row, q)] for row in below]) for name, q in QUANTILES.items()
            }
        return {**{name: values.reshape(3, 1, 1) for name, values in found.items()}, "count": np.array([self._count])}


Statistics = OfValues | OfPictures
"""Minimum, maximum, mean, standard deviation, count and quantiles at each place of a feature."""


def decoded(png: bytes) -> UInt8[np.ndarray, "row column 3"]:
    """The picture, RGB, of a PNG file's contents."""
    return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR))[..., ::-1]
