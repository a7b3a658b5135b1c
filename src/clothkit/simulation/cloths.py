"""The cloths of recorded sequences, and the worlds in which they are simulated again.

This module starts no simulator, since datasets and nets need to know cloths, too.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int8

from clothkit.cloth.topology import CLOTH_LENGTH, Topology, rectangle, square
from clothkit.simulation.material import THICKEST, THINNEST
from clothkit.simulation.settings import DRAWN, LEAST_SPACING, SimulationConfig


class Cloths(NamedTuple):
    """The cloths of n sequences, as a dataset holds them."""

    cloth: Float[np.ndarray, "n 3"]
    """Sides along u and along v, and thickness [normalised]."""
    start: Int8[np.ndarray, " n"]
    """Index into STARTS."""
    material: Float[np.ndarray, "n properties"]
    """The properties in DRAWN, in SI units; NaN where a simulator did not tell them."""

    def world(self, row: int, simulation: SimulationConfig) -> tuple[SimulationConfig, Topology]:
        """The world of one sequence; what is not known is that of `simulation`."""
        known = zip(DRAWN, self.material[row].tolist(), strict=True)
        values = {name: value for name, value in known if not math.isnan(value)}
        sides = (float(self.cloth[row, 0]), float(self.cloth[row, 1]))
        return with_material(simulation, values), topology_of(simulation.side, sides)


def simulated_cloths(cloth: Float[np.ndarray, "n 3"], simulation: SimulationConfig) -> Cloths:
    """Cloths of which only sides and thickness are known [normalised]; all else is that of `simulation`.

    A cloth that is thicker than the grid allows is as thick as it allows.
    """
    count = len(cloth)
    material = np.full((count, len(DRAWN)), np.nan, np.float32)
    spacing = cloth[:, :2].min(1) * (simulation.cloth_side / CLOTH_LENGTH) / (simulation.side - 1)
    thickness = cloth[:, 2] * (simulation.cloth_side / CLOTH_LENGTH)
    thickest = np.minimum(THICKEST, 0.999 * spacing / LEAST_SPACING)
    material[:, DRAWN.index("thickness")] = np.clip(thickness, THINNEST, thickest)
    return Cloths(cloth.astype(np.float32), np.zeros(count, np.int8), material)


def topology_of(vertices: int, sides: tuple[float, float]) -> Topology:
    """The square or rectangle with these sides [normalised] and so many vertices along each, with its symmetries."""
    along_u, along_v = (CLOTH_LENGTH if side == max(sides) else side for side in sides)
    if along_u == along_v:
        return square(vertices)
    return Topology((vertices, vertices), (along_u, along_v), rectangle(along_u / along_v).symmetries)


def with_material(simulation: SimulationConfig, values: dict[str, float]) -> SimulationConfig:
    """The simulation with another cloth: these properties of its material."""
    return replace(simulation, material=replace(simulation.material, **values))
