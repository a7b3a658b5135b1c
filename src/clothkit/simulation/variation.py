"""Variation of the simulated world: what each sequence draws of its cloth, of the friction and of its start.

The longer side of every cloth is `SimulationConfig.cloth_side`. A cloth of another size behaves like one of that side
whose thickness, and whose bending stiffness per weight, are scaled to it: they decide how it bends under its own
weight, by (bending stiffness / (density g))^(1/3), a length. So ranges of these two cover cloths of all sizes;
`similarity.resized` does this for a material.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from clothkit.cloth.topology import CLOTH_LENGTH, Topology
from clothkit.manipulation.named_folds import GOALS, manipulations, turned
from clothkit.manipulation.vector import is_null
from clothkit.simulation.cloths import topology_of, with_material
from clothkit.simulation.kernels.state import PATH
from clothkit.simulation.settings import DRAWN, LEAST_SPACING, STARTS, SimulationConfig, Start, Starts, VariationConfig
from clothkit.simulation.solver import flat_state
from clothkit.simulation.world import Motion

STREAM = 1
"""Number of the stream of random numbers for variation, so that manipulations are drawn from another one.

The next two are those of openings and of the folds of named goals.
"""

REACHED = (0.82, 0.98)
"""By which share of a fold's way the hands move: cloth that is let go slides on."""

ASTRAY = 0.02
"""Standard deviation of grasps and displacements of the folds of named goals [cloth length]."""


class Drawn(NamedTuple):
    """The world of one sequence."""

    simulation: SimulationConfig
    topology: Topology
    start: Start


def draw(simulation: SimulationConfig, variation: VariationConfig, *, seed: int, number: int) -> Drawn:
    """The world of an attempt, which depends on the seed and its number alone."""
    rng = np.random.default_rng([seed, number, STREAM])
    sides = (CLOTH_LENGTH, CLOTH_LENGTH)
    if rng.random() >= variation.squares:
        sides = (CLOTH_LENGTH, _rounded(CLOTH_LENGTH / _between(rng, variation.ratio)))
    topology = topology_of(simulation.side, sides)
    # A little less, so that rounding does not make it too thick.
    thickest = 0.999 * min(simulation.spacing(topology)) / LEAST_SPACING
    values = {}
    for name in DRAWN:
        if (limits := getattr(variation, name)) is not None:
            values[name] = _between(
                rng, (min(limits[0], thickest), min(limits[1], thickest)) if name == "thickness" else limits
            )
    shares = np.array([getattr(variation.starts, start) for start in STARTS])
    start = STARTS[int(rng.choice(len(STARTS), p=shares / shares.sum()))]
    return Drawn(with_material(simulation, values), topology, start)


def opening(drawn: Drawn, starts: Starts, *, seed: int, number: int) -> Motion | None:
    """The motion that brings the flat cloth to its start, or None if it begins flat. One hand holds any vertex.

    Dragged: the hand is lifted a little, and moves in a straight line in any direction. Dropped: it is lifted and lets
    the cloth fall.
    """
    if drawn.start == "flat":
        return None
    rng = np.random.default_rng([seed, number, STREAM + 1])
    settings, flat = drawn.simulation, flat_state(drawn.simulation, drawn.topology).reshape(-1, 3)
    vertex = int(rng.integers(len(flat)))
    turn = rng.uniform(0, 2 * np.pi)
    along = np.array([np.cos(turn), np.sin(turn), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    if drawn.start == "dragged":
        lift = 2 * settings.material.thickness + 0.02 * settings.cloth_side
        corners = np.stack([0 * up, lift * up, lift * up + settings.cloth_side * _between(rng, starts.drag) * along])
    else:
        height = settings.cloth_side * _between(rng, starts.drop)
        corners = np.stack([0 * up, height * up + 0.2 * height * rng.random() * along])
    far = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=-1))])
    time = np.linspace(0, 1, int(PATH))
    place = (time**2 * (3 - 2 * time)) * far[-1]
    offset = np.stack([np.interp(place, far, corners[:, axis]) for axis in range(3)], axis=-1)
    path = flat[vertex] + np.stack([offset, offset])
    held = np.array([[[vertex], [-1]]])
    return Motion(held, path[None], np.array([max(far[-1] / settings.hand_speed, settings.shortest_move)]))


class Script(NamedTuple):
    """The first manipulations of a sequence: nearly the folds of a named goal."""

    goal: str
    manipulations: Float[np.ndarray, "folds 6"]


def script(drawn: Drawn, share: float, *, seed: int, number: int) -> Script | None:
    """The folds with which a sequence begins, or None if they are random: any named goal's, from any side of the cloth.

    Hands that fold as people do leave edges that lie on one another, which random hands hardly ever do. Grasps and
    displacements differ a little from those of the goal (ASTRAY, REACHED), as those of hands do.
    """
    rng = np.random.default_rng([seed, number, STREAM + 2])
    if drawn.start != "flat" or rng.random() >= share:
        return None
    goal = list(GOALS.values())[rng.integers(len(GOALS))]
    quarters, mirrored = int(rng.integers(4)), bool(rng.integers(2))
    along_u, along_v = drawn.topology.sides
    seen = topology_of(drawn.topology.shape[0], (along_v, along_u)) if quarters % 2 else drawn.topology
    exact = turned(manipulations(seen, goal.folds(seen)), quarters=quarters, mirrored=mirrored)
    reached = rng.uniform(*REACHED, (len(exact), 1))
    astray = rng.normal(0.0, ASTRAY * CLOTH_LENGTH, exact.shape)
    single = (exact[:, :2] == exact[:, 2:4]).all(1)
    astray[single, 2:4] = astray[single, :2]
    grasps = np.clip(exact[:, :4] + astray[:, :4], -1, 1)
    moves = np.concatenate([grasps, exact[:, 4:] * reached + astray[:, 4:]], axis=1)
    # Of a narrow cloth, a corner may go in by less than a manipulation moves at least: what follows is random.
    kept = np.logical_and.accumulate(~np.asarray(is_null(moves)))
    return Script(goal.name, moves[kept]) if kept.any() else None


def _between(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    return _rounded(math.exp(rng.uniform(math.log(limits[0]), math.log(limits[1]))))


def _rounded(value: float) -> float:
    """The value as a dataset records it, so that its world can be built again to the last bit."""
    return float(np.float32(value))
