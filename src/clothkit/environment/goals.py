"""How the cloth of an episode lies at first, and what it shall become: meshes, what draws them, or names."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import Topology
from clothkit.goals.problems import Problem
from clothkit.goals.settings import START_NAMES, EvaluateGoalsConfig, StartName
from clothkit.goals.starts import cloth_of, cloths_of, start_of
from clothkit.goals.store import made, named
from clothkit.goals.variants import angle_of
from clothkit.manipulation.named_folds import GOALS
from clothkit.runtime.errors import InputError
from clothkit.simulation.settings import SimulateConfig, SimulationConfig

Mesh = Float[np.ndarray, "u v 3"]
"""Normalised; where it lies is of no importance for a goal."""

MeshSampler = Callable[[np.random.Generator], Mesh]
"""Draws a mesh [normalised] by a generator of random numbers: the same generator, the same mesh."""

Start = Mesh | MeshSampler | StartName

Goal = Mesh | MeshSampler | str | Sequence[str]
"""A mesh, what draws one, the name of a goal (`clothkit goals`), or several of which one is drawn."""

DRAWS = 1_000_000
"""Number of the cloths among which a start is drawn."""


class Target(NamedTuple):
    """The goal of an episode."""

    mesh: Mesh
    """Centred."""
    problem: Problem | None
    """What the goal is of the cloth as it lay at first; None if it has no name."""


def names_of(goal: object) -> tuple[str, ...]:
    """The names among which a goal is drawn; none if it is a mesh or draws one. Raises InputError for unknown names."""
    if isinstance(goal, str):
        return (named(goal).name,)
    if isinstance(goal, np.ndarray) or callable(goal):
        return ()
    names = tuple(goal) if isinstance(goal, Sequence) else ()
    if not names or not all(isinstance(name, str) for name in names):
        raise InputError(f"goal: expected a mesh, a function that draws one, or names of goals, found {goal!r}")
    return tuple(named(name).name for name in names)


def needed(goal: object) -> int | None:
    """How many manipulations a named goal needs, the most of several; None for meshes."""
    return max((GOALS[name].manipulations for name in names_of(goal)), default=None)


def start_mesh(start: object, rng: np.random.Generator, simulation: SimulationConfig, topology: Topology) -> Mesh:
    """The cloth as it lies at first, at its place on the table. Raises InputError."""
    if not isinstance(start, str):
        return drawn(start, rng, topology.shape, name="start")
    for name in START_NAMES:
        if name == start:
            return start_of(int(rng.integers(DRAWS)), name, *_evaluated(simulation)).mesh
    names = ", ".join(START_NAMES)
    raise InputError(f"start: expected a mesh, a function that draws one, or one of {names}, found {start!r}")


def target_of(
    goal: object,
    start: Mesh,
    rng: np.random.Generator,
    simulation: SimulationConfig,
    topology: Topology,
    *,
    folder: Path,
) -> Target:
    """The goal of an episode; a named one lies turned as the cloth does, and is kept in `folder`. Raises InputError."""
    names = names_of(goal)
    if not names:
        return Target(centred(drawn(goal, rng, topology.shape, name="goal"))[0], None)
    name = names[int(rng.integers(len(names)))]
    found = made(name, topology, simulation, folder=folder)
    cloths = cloths_of(cloth_of(0, *_evaluated(simulation)), 1)
    problem = Problem(name, "flat", 0, start, angle_of(start, topology), found, topology, cloths)
    return Target(problem.goal, problem)


def drawn(what: object, rng: np.random.Generator, shape: tuple[int, int], *, name: str) -> Mesh:
    """The mesh, or one that is drawn. Raises InputError unless it is finite and of the grid's shape."""
    mesh = np.asarray(what(rng) if callable(what) else what, np.float32)
    if mesh.shape != (*shape, 3):
        raise InputError(f"{name}: has shape {list(mesh.shape)}, expected a mesh {[*shape, 3]}, normalised")
    if not np.isfinite(mesh).all():
        raise InputError(f"{name}: has vertices that are not finite")
    return mesh


def _evaluated(simulation: SimulationConfig) -> tuple[EvaluateGoalsConfig, SimulateConfig]:
    """Settings of stages, of this one world."""
    return EvaluateGoalsConfig(), SimulateConfig(sequences=1, simulation=simulation)
