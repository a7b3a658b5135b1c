"""The table's plane: a search for it in a point cloud by RANSAC, and the table's frame."""

import dataclasses
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le
from jaxtyping import Float

from clothkit.runtime.config import config
from clothkit.runtime.errors import InputError

_CANDIDATE_POINTS = 4000
_REFINEMENTS = 3
_LEAST_POINTS = 50


@config
class PlaneConfig:
    """Settings of the search for the table's plane."""

    tolerance: Annotated[float, Gt(0)] = 0.008
    """Largest distance of a table point from the plane [m]."""
    tries: Annotated[int, Gt(0)] = 200
    """Number of candidate planes, each through three random points."""
    share: Annotated[float, Gt(0), Le(1)] = 0.4
    """Least share of the points outside the cloth that must lie on the table."""
    seed: Annotated[int, Ge(0)] = 0


@dataclasses.dataclass(frozen=True)
class Plane:
    """The points p with normal . p = offset; the cloth lies on the side to which the normal points."""

    normal: Float[np.ndarray, "3"]
    """Of length 1."""
    offset: float
    """Metres."""

    def heights(self, points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points"]:
        """The heights of points above the table [m]."""
        return np.asarray(points @ self.normal - self.offset)

    def frame(self) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
        """The table's axes as rows, and its origin [m], both in the frame in which the plane is given.

        z is the normal. x is the given frame's x axis projected onto the plane (its y axis, if x is almost the normal).
        The origin is the given frame's origin projected onto the plane. A camera that looks down sees x to the right
        and y upwards. For the plane z = 0 both frames are the same.
        """
        reference = np.eye(3)[0] if abs(self.normal[0]) < 0.9 else np.eye(3)[1]
        x = reference - (reference @ self.normal) * self.normal
        x /= np.linalg.norm(x)
        return np.stack([x, np.cross(self.normal, x), self.normal]), self.offset * self.normal


LEVEL = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
"""The plane z = 0: the table of a cloud that is in the table's frame."""


def plane_of(coefficients: Sequence[float]) -> Plane:
    """The plane a x + b y + c z = d [m], as from calibration; (a, b, c) points up and has any length but 0.

    Raises InputError unless `coefficients` are four finite numbers and (a, b, c) is not 0.
    """
    values = np.asarray(coefficients, float)
    length = np.linalg.norm(values[:3])
    if values.shape != (4,) or not np.isfinite(values).all() or length == 0:
        raise InputError(f"table {tuple(coefficients)}: expected a, b, c, d of a plane a x + b y + c z = d")
    return Plane(values[:3] / length, float(values[3] / length))


def find(
    points: Float[np.ndarray, "points 3"],
    settings: PlaneConfig,
    *,
    name: str = "cloud",
) -> Plane:
    """The plane on which most of the points lie. Same seed, same plane.

    `points` are those outside the cloth. The normal may point to either side. Raises InputError when too few points lie
    on one plane.
    """
    if len(points) < _LEAST_POINTS:
        raise InputError(
            f"{name}: table not found, there are {len(points)} points outside the cloth, expected at least "
            f"{_LEAST_POINTS}; give the table's plane"
        )
    random = np.random.default_rng(settings.seed)
    some = points[random.choice(len(points), min(len(points), _CANDIDATE_POINTS), replace=False)]
    plane = _ransac(some, settings, random)
    on_it = np.abs(plane.heights(points)) < settings.tolerance
    for _ in range(_REFINEMENTS):
        plane = _fit(points[on_it]) if on_it.sum() >= 3 else plane
        on_it = np.abs(plane.heights(points)) < settings.tolerance
    if on_it.mean() < settings.share:
        raise InputError(
            f"{name}: table not found, of the points outside the cloth {on_it.mean():.0%} lie on one plane, expected "
            f"at least {settings.share:.0%}; crop with box or give the table's plane"
        )
    return plane


def _ransac(points: np.ndarray, settings: PlaneConfig, random: np.random.Generator) -> Plane:
    a, b, c = np.moveaxis(points[random.integers(len(points), size=(settings.tries, 3))], 1, 0)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.where(lengths > 0, normals / np.where(lengths > 0, lengths, 1), [0.0, 0.0, 1.0])
    offsets = (normals * a).sum(-1)
    best = np.argmax((np.abs(points @ normals.T - offsets) < settings.tolerance).sum(0))
    return Plane(normals[best], float(offsets[best]))


def _fit(points: np.ndarray) -> Plane:
    """The least-squares plane through points."""
    middle = points.mean(0)
    moved = points - middle
    normal = np.linalg.eigh(moved.T @ moved)[1][:, 0]
    return Plane(normal, float(normal @ middle))
