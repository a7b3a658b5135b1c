"""Names in the place of goal files: the goal is made of the user's cloth, and lies as the cloth lies."""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
from jaxtyping import Float

from clothkit.app.inputs import Input, Settings
from clothkit.app.options import ObservationOptions
from clothkit.app.plan_file import Plan
from clothkit.app.planner import estimate_mesh, load_vtm, mesh_of
from clothkit.cloth.topology import Topology
from clothkit.dataset.store import STEPS
from clothkit.goals.store import user_folder
from clothkit.goals.variants import Turn, Variant, angle_of, goal_mesh
from clothkit.manipulation.named_folds import GOALS
from clothkit.observation.observe import observe
from clothkit.observation.states import MeshState
from clothkit.runtime.errors import InputError
from clothkit.simulation.cloths import simulated_cloths
from clothkit.simulation.settings import SimulationConfig

TURNS: dict[str, Turn] = {"0": 0, "90": 90, "180": 180, "270": 270}
"""The values of the option --turn."""


def with_variant_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator that adds the options `turn` and `mirror` of named goals."""
    for option in (
        click.option(
            "--mirror", is_flag=True, default=None, help="A named goal's folds are mirrored, before they are turned."
        ),
        click.option(
            "--turn",
            type=click.Choice(list(TURNS)),
            help="Degrees by which a named goal's folds are turned on the cloth, counter-clockwise, to be made from "
            "another side.",
        ),
    ):
        command = option(command)
    return command


def goal_name(goal: object, turn: Turn | None, mirror: bool | None) -> str | None:
    """The goal's name, None if it is anything else, such as a file.

    Raises InputError if it is neither, and for a turn or a mirroring of what has no name.
    """
    if isinstance(goal, str) and goal in GOALS:
        if turn is not None and turn not in TURNS.values():
            raise InputError(f"--turn: expected one of {', '.join(TURNS)}, found {turn!r}")
        return goal
    # A file that is there is read, or refused for its own reason; a dataset's state is data/meshes.zarr:0/1.
    if isinstance(goal, str) and re.fullmatch(r"[\w-]+", goal) and not os.path.lexists(goal):
        raise InputError(f"--goal: expected a file or one of {', '.join(GOALS)}, found {goal!r}")
    told = "not given" if goal is None else goal if isinstance(goal, str | Path) else "given as arrays"
    for name, given in (("turn", turn), ("mirror", mirror)):
        if given is not None:
            raise InputError(f"--{name}: is for named goals, but the goal is {told}")
    return None


def goal_option(goal: str | None, turn: str | None, mirror: bool | None) -> tuple[str | None, Turn | None]:
    """The goal's name, as `goal_name` has it, and the turn, by the options; a notice tells if it is a file's name, too.

    Raises InputError.
    """
    angle = None if turn is None else TURNS[turn]
    name = goal_name(goal, angle, mirror)
    if name is not None and os.path.lexists(name):
        click.echo(f"notice: --goal {name}: the named goal is meant, and not the file ./{name}", err=True)
    return name, angle


def manipulations_of(name: str) -> int:
    """How many manipulations of a plan lead to a named goal: as many as it needs, as far as a plan has so many."""
    return min(GOALS[name].manipulations, STEPS)


def variant_before(
    name: str, plan: Plan | None, source: Path | None, turn: Turn | None, mirror: bool | None
) -> Variant | None:
    """How a goal lay that a plan was made for; None if there is no plan, or it is for a file.

    Raises InputError if the plan is for another named goal, or another side of the cloth than `turn` and `mirror` tell.
    """
    if plan is None or plan.goal.named is None:
        return None
    told = plan.goal.named
    if plan.goal.file != name:
        raise InputError(f"--goal: expected {plan.goal.file}, for which {source} was planned, found {name}")
    if turn is not None and turn != told.turn_deg:
        raise InputError(f"--turn: expected {told.turn_deg}, for which {source} was planned, found {turn}")
    if mirror and not told.mirror:
        raise InputError(f"--mirror: {source} was planned for a goal that is not mirrored")
    return Variant(turn=told.turn_deg, mirror=told.mirror, angle=told.angle_rad)


def variant_of(turn: Turn | None, mirror: bool | None, mesh: Float[np.ndarray, "u v 3"], topology: Topology) -> Variant:
    """The side of the cloth that is told, turned as the cloth lies whose mesh is given."""
    return Variant(turn=turn or 0, mirror=bool(mirror), angle=angle_of(mesh, topology))


def lying(start: Input, data: Path, settings: Settings) -> Float[np.ndarray, "u v 3"]:
    """A mesh that tells how a cloth lies: the file's own, or an estimate of it."""
    mesh = mesh_of(start)
    return np.asarray(estimate_mesh(load_vtm(data), start, settings).mesh[0]) if mesh is None else mesh


def world_of(options: ObservationOptions, simulation: SimulationConfig) -> tuple[SimulationConfig, Topology]:
    """The simulated world of the user's cloth."""
    return simulated_cloths(options.cloth[None], simulation).world(0, simulation)


def named_goal(name: str, variant: Variant, options: ObservationOptions, settings: Settings) -> Input:
    """A named goal of the user's cloth, as if it were read from a file. Raises InputError if it can't be made."""
    simulation, topology = world_of(options, settings.simulation)
    mesh = goal_mesh(name, topology, simulation, variant, folder=user_folder())
    state = MeshState(mesh, np.zeros(2, np.float32), options.scale)
    observation = observe(state, cloth_side=options.side, settings=options.cloud, name=name)
    return Input(name, state, observation, options.cloth, variant)


def goal_like(
    start: Input,
    name: str,
    turn: Turn | None,
    mirror: bool | None,
    options: ObservationOptions,
    settings: Settings,
) -> Input:
    """A named goal of the user's cloth that lies turned as the cloth does in `start`. Raises InputError."""
    variant = variant_of(turn, mirror, lying(start, settings.data, settings), options.topology)
    return named_goal(name, variant, options, settings)
