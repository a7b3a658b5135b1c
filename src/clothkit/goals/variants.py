"""The same goal from another side of the cloth, and on a table on which the cloth lies turned (section 4.6)."""

from pathlib import Path
from typing import Annotated, Literal

import jax.numpy as jnp
import numpy as np
from annotated_types import Ge, Le
from jaxtyping import Float

from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import Topology
from clothkit.goals.making import Made, rigid
from clothkit.goals.store import made
from clothkit.manipulation.named_folds import turned
from clothkit.manipulation.turns import planar, turn_mesh
from clothkit.runtime.config import config
from clothkit.simulation.cloths import topology_of
from clothkit.simulation.settings import SimulationConfig

Turn = Literal[0, 90, 180, 270]
"""Degrees, counter-clockwise."""

Mesh = Float[np.ndarray, "u v 3"]


@config
class Variant:
    """From which side a goal is folded, and how the cloth lies."""

    turn: Turn = 0
    """By how much its folds are turned on the cloth."""
    mirror: bool = False
    """Whether they are mirrored, before that: what was done at v is done at -v."""
    angle: Annotated[float, Ge(-np.pi), Le(np.pi)] = 0.0
    """By how much the cloth itself is turned on the table, counter-clockwise [rad]: 0 if u runs along x."""


def base(topology: Topology, variant: Variant) -> Topology:
    """The topology of whose goal the variant is an image: with the sides exchanged after an odd number of quarters."""
    along_u, along_v = topology.sides
    return topology_of(topology.shape[0], (along_v, along_u)) if variant.turn in (90, 270) else topology


def image(made: Made, variant: Variant) -> Made:
    """The image of a goal of `base`: the cloth lies as before, its folds are turned and mirrored."""
    x, y, z = np.moveaxis(made.states, -1, 0)
    if variant.mirror:
        # The labels follow, so that the upper side stays up.
        x, y, z = x[..., ::-1], -y[..., ::-1], z[..., ::-1]
    quarters = variant.turn // 90
    for _ in range(quarters):
        # What lay at (u, v) lies at (-v, u).
        x, y, z = (np.swapaxes(part, -1, -2)[..., ::-1, :] for part in (-y, x, z))
    manipulations = turned(made.manipulations, quarters=quarters, mirrored=variant.mirror)
    return Made(np.stack([x, y, z], axis=-1), manipulations)


def lay(mesh: Mesh, angle: float) -> Mesh:
    """The mesh, turned counter-clockwise about z [rad]."""
    return np.asarray(turn_mesh(jnp.asarray(mesh), planar(jnp.asarray(angle), jnp.asarray(False))))


def goal_mesh(name: str, topology: Topology, simulation: SimulationConfig, variant: Variant, *, folder: Path) -> Mesh:
    """A variant of a named goal, normalised and centred. Raises InputError, as `store.made` does."""
    return placed(made(name, base(topology, variant), simulation, folder=folder), variant)


def placed(found: Made, variant: Variant) -> Mesh:
    """The goal's mesh, normalised and centred, from that of `base`."""
    return centred(lay(image(found, variant).states[-1], variant.angle))[0]


def angle_of(mesh: Mesh, topology: Topology) -> float:
    """By how much a cloth lies turned on the table [rad], the smallest of all angles that look the same.

    It is the rotation of the flat cloth, whichever side is up, that brings its vertices nearest to the mesh's in x and
    y: of a folded or crumpled cloth, the one by which the least is left to move.
    """
    xy = mesh[..., :2].reshape(-1, 2).astype(float)
    flat = topology.flat()[..., :2].astype(float)
    fits = []
    for labelled in (flat, flat[::-1]):
        turn, shift = rigid(labelled.reshape(-1, 2), xy)
        left = float(np.linalg.norm(labelled.reshape(-1, 2) @ turn.T + shift - xy))
        fits.append((left, float(np.arctan2(turn[1, 0], turn[0, 0]))))
    angle, same = min(fits)[1], np.pi / 2 if topology.swaps else np.pi
    return angle - same * round(angle / same)
