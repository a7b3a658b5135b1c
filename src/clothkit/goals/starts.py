"""The cloths from which named goals are planned for: flat, dragged over the table, or dropped on it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.goals.making import LIMITS
from clothkit.goals.settings import EvaluateGoalsConfig, StartName
from clothkit.goals.variants import lay
from clothkit.runtime.errors import InputError
from clothkit.simulation.cloths import Cloths
from clothkit.simulation.quality import measure, reason
from clothkit.simulation.settings import DRAWN, STARTS, SimulateConfig, Start, Starts
from clothkit.simulation.solver import flat_state
from clothkit.simulation.variation import Drawn, draw, opening
from clothkit.simulation.world import Worlds

SIMULATED: dict[StartName, Start] = {"flat": "flat", "dragged": "dragged", "crumpled": "dropped"}
"""The simulator's word for each start."""

ATTEMPTS = 50
"""Most motions that are drawn until one leaves a clean cloth."""

ANGLES = 2
"""Number of the stream of random numbers for the angles at which cloths lie."""


class Laid(NamedTuple):
    """A cloth as it lies at first."""

    mesh: Float[np.ndarray, "u v 3"]
    """At its place on the table [normalised]."""


def cloth_of(repeat: int, settings: EvaluateGoalsConfig, simulate: SimulateConfig) -> Drawn:
    """The world of a repeat: its own if the simulation varies, else that of all."""
    if simulate.variation is None:
        return Drawn(simulate.simulation, simulate.simulation.topology, "flat")
    return draw(simulate.simulation, simulate.variation, seed=settings.seed, number=repeat)


def cloths_of(drawn: Drawn, count: int) -> Cloths:
    """The cloth of a world, `count` times, as datasets hold it."""
    simulation = drawn.simulation
    thickness = simulation.material.thickness * CLOTH_LENGTH / simulation.cloth_side
    exact = np.array([getattr(simulation.material, name) for name in DRAWN])
    # Rounded down, so that none leaves its range.
    nearest = exact.astype(np.float32)
    material = np.where(nearest > exact, np.nextafter(nearest, np.float32(0)), nearest)
    return Cloths(
        np.tile(np.array([*drawn.topology.sides, thickness], np.float32), (count, 1)),
        np.full(count, STARTS.index(drawn.start), np.int8),
        np.tile(material, (count, 1)),
    )


def start_of(repeat: int, name: StartName, settings: EvaluateGoalsConfig, simulate: SimulateConfig) -> Laid:
    """The cloth of a repeat as it lies at first, at a random angle.

    Raises InputError if no motion leaves a clean cloth.
    """
    drawn = cloth_of(repeat, settings, simulate)._replace(start=SIMULATED[name])
    rng = np.random.default_rng([settings.seed, repeat, list(SIMULATED).index(name), ANGLES])
    mesh = _opened(drawn, repeat, settings, simulate) * np.float32(CLOTH_LENGTH / drawn.simulation.cloth_side)
    return Laid(lay(mesh, float(rng.uniform(-np.pi, np.pi))))


def _opened(
    drawn: Drawn, repeat: int, settings: EvaluateGoalsConfig, simulate: SimulateConfig
) -> Float[np.ndarray, "u v 3"]:
    """The cloth after the motion that brings it to its start [m]."""
    flat = flat_state(drawn.simulation, drawn.topology)
    starts = Starts() if simulate.variation is None else simulate.variation.starts
    limits = SimulateConfig(sequences=1, simulation=drawn.simulation, limits=LIMITS)
    worlds, why = Worlds(1, drawn.simulation, drawn.topology), ""
    for attempt in range(ATTEMPTS):
        motion = opening(drawn, starts, seed=settings.seed, number=ATTEMPTS * repeat + attempt)
        if motion is None:
            return flat
        outcome = worlds.execute(flat[None], motion)
        why = reason(measure(outcome.states, drawn.simulation, drawn.topology), outcome, limits, 0)
        if not why:
            return outcome.states[0]
    raise InputError(f"evaluate_goals: none of {ATTEMPTS} cloths that were {drawn.start} was clean (the last: {why})")
