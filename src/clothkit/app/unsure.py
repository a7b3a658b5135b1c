"""Where an estimate is poor: the vertices of large standard deviation, and the part of the cloth that they are."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.spatial import cKDTree

from clothkit.cloth.layers import APART
from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE
from clothkit.cloth.voxels import RESOLUTION
from clothkit.planning.trust import NEAR

THRESHOLD = NEAR
"""Standard deviation of a vertex's place from which it is unsure [cloth length]: the distance from its goal at which a
plan no longer counts as one that came true."""

PartName = Literal["corner", "edge", "rim", "quarter", "middle", "half", "whole"]
_QUARTER, _RIM = 8, 4  # vertices: a quarter and an eighth of a side


class Unsure(NamedTuple):
    """The unsure vertices of an estimate."""

    share: float
    """Of all vertices."""
    part: PartName
    """The part of the flat cloth that they are most like."""
    centre: Float[np.ndarray, "3"]
    """The middle of those that are in this part [normalised]."""
    hidden: float
    """The share of them that lies beneath another layer of the estimated mesh."""
    unseen: float
    """The share of them that lies where nothing was observed, and not beneath another layer."""


def unsure_part(
    mesh: Float[np.ndarray, "u v 3"], std: Float[np.ndarray, "u v 3"], voxels: Bool[np.ndarray, "x y z"]
) -> Unsure | None:
    """Return where an estimated mesh is unsure; None: nowhere.

    `std` has the standard deviations of its coordinates; both are normalised. `voxels` are what it was estimated from.
    """
    unsure = vertex_sigma(std) > THRESHOLD
    if not unsure.any():
        return None
    part, mask = max(_masks(), key=lambda named: float((named[1] & unsure).sum() / (named[1] | unsure).sum()))
    beneath = _beneath(mesh)
    return Unsure(
        share=float(unsure.mean()),
        part=part,
        centre=mesh[unsure & mask].astype(float).mean(axis=0),
        hidden=float(beneath[unsure].mean()),
        unseen=float((_unobserved(mesh, voxels) & ~beneath)[unsure].mean()),
    )


def vertex_sigma(std: Float[np.ndarray, "u v 3"]) -> Float[np.ndarray, "u v"]:
    """Return the standard deviation of each vertex's place [cloth length], from those of its coordinates [normalised].

    The square of it is the sum of the variances of x, y and z.
    """
    return np.sqrt(np.sum(std.astype(float) ** 2, axis=-1)) / CLOTH_LENGTH


def _masks() -> list[tuple[PartName, Bool[np.ndarray, "u v"]]]:
    """The parts of a flat cloth by name, each as often as there are such parts."""
    u, v = np.indices(SQUARE.shape)
    last_u, last_v = SQUARE.shape[0] - 1, SQUARE.shape[1] - 1
    from_edges = [u, last_u - u, v, last_v - v]
    strips, halves = ([steps < wide for steps in from_edges] for wide in (_QUARTER, 2 * _QUARTER))
    inward = np.min(from_edges, axis=0)
    of_two = [(a, b) for a in (0, 1) for b in (2, 3)]
    masks: list[tuple[PartName, np.ndarray]] = [("corner", strips[a] & strips[b]) for a, b in of_two]
    masks += [("edge", strip) for strip in strips]
    masks += [("rim", inward < _RIM)]
    masks += [("quarter", halves[a] & halves[b]) for a, b in of_two]
    masks += [("middle", inward >= _QUARTER)]
    masks += [("half", half) for half in halves]
    return [*masks, ("whole", np.ones(SQUARE.shape, bool))]


def _beneath(mesh: Float[np.ndarray, "u v 3"]) -> Bool[np.ndarray, "u v"]:
    """Which vertices have a vertex above them that is far away along the cloth."""
    flat = mesh.astype(float).reshape(-1, 3)
    pairs = cKDTree(flat[:, :2]).query_pairs(max(SQUARE.spacing), output_type="ndarray")
    u, v = np.divmod(pairs, mesh.shape[1])
    pairs = pairs[np.maximum(np.abs(np.diff(u)), np.abs(np.diff(v)))[:, 0] >= APART]
    beneath = np.zeros(len(flat), bool)
    beneath[np.where(flat[pairs[:, 0], 2] < flat[pairs[:, 1], 2], pairs[:, 0], pairs[:, 1])] = True
    return beneath.reshape(mesh.shape[:2])


def _unobserved(mesh: Float[np.ndarray, "u v 3"], voxels: Bool[np.ndarray, "x y z"]) -> Bool[np.ndarray, "u v"]:
    """Which vertices lie in columns that hold no voxel, and in none beside one that does."""
    observed = ndimage.binary_dilation(voxels.any(-1), structure=np.ones((3, 3)))
    column = np.floor((mesh[..., :2] + 1) * (np.array(RESOLUTION[:2]) / 2)).astype(int)
    inside = ((column >= 0) & (column < RESOLUTION[:2])).all(-1)
    x, y = np.clip(column, 0, np.array(RESOLUTION[:2]) - 1).transpose(2, 0, 1)
    return ~(inside & observed[x, y])
