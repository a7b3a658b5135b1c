"""Names in the place of goal files: the goal is made of the user's cloth, and lies as the cloth lies."""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
from jaxtyping import Float

from clothkit.app.inputs import Input, ObservationOptions, Settings
from clothkit.app.plan_file import Plan
from clothkit.app.planner import estimate_mesh, load_vtm, mesh_of
from clothkit.cloth.topology import Topology
from clothkit.goals.folds import GOALS
from clothkit.goals.store import user_folder
from clothkit.goals.variants import Turn, Variant, angle_of, goal_mesh
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


def goal_name(goal: str | None, turn: str | None, mirror: bool | None) -> str | None:
    """The goal's name, None if it is a file.

    Prints a notice if it is both. Raises InputError if it is neither, and for options of names beside a file.
    """
    if goal in GOALS:
        if os.path.lexists(goal):
            click.echo(f"notice: --goal {goal}: the named goal is meant, and not the file ./{goal}", err=True)
        return goal
    # A file that is there is read, or refused for its own reason; a dataset's state is data/meshes.zarr:0/1.
    if goal is not None and re.fullmatch(r"[\w-]+", goal) and not os.path.lexists(goal):
        raise InputError(f"--goal: expected a file or one of {', '.join(GOALS)}, found {goal!r}")
    for name, given in (("turn", turn), ("mirror", mirror)):
        if given is not None:
            raise InputError(f"--{name}: is for named goals, but the goal is {'not given' if goal is None else goal}")
    return None


def variant_before(
    name: str, plan: Plan | None, source: Path | None, turn: str | None, mirror: bool | None
) -> Variant | None:
    """How a goal lay that a plan was made for; None if there is no plan, or it is for a file.

    Raises InputError if the plan is for another named goal, or another side of the cloth than the options tell.
    """
    if plan is None or plan.goal.named is None:
        return None
    told = plan.goal.named
    if plan.goal.file != name:
        raise InputError(f"--goal: expected {plan.goal.file}, for which {source} was planned, found {name}")
    if turn is not None and int(turn) != told.turn_deg:
        raise InputError(f"--turn: expected {told.turn_deg}, for which {source} was planned, found {turn}")
    if mirror and not told.mirror:
        raise InputError(f"--mirror: {source} was planned for a goal that is not mirrored")
    return Variant(turn=told.turn_deg, mirror=told.mirror, angle=told.angle_rad)


def variant_of(turn: str | None, mirror: bool | None, mesh: Float[np.ndarray, "u v 3"], topology: Topology) -> Variant:
    """The side of the cloth that the options tell, turned as the cloth lies whose mesh is given."""
    return Variant(turn=TURNS[turn or "0"], mirror=bool(mirror), angle=angle_of(mesh, topology))


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
    for notice in observation.notices:
        click.echo(f"notice: {notice}", err=True)
    return Input(name, state, observation, options.cloth, variant)
