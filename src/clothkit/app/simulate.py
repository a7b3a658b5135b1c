"""`clothkit simulate`: execute a plan in the simulator."""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import click
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from clothkit.app.agreement import compare_estimate, warn
from clothkit.app.inputs import Input, keep_compiled_programs, read_input, tell
from clothkit.app.named_goals import goal_option, named_goal, variant_before, variant_of, with_variant_options
from clothkit.app.options import observation_options, with_observation_options
from clothkit.app.output import check_target, part, write_mesh
from clothkit.app.plan_arrays import cloth_of, placed_state
from clothkit.app.plan_file import Plan, read_plan
from clothkit.app.plan_parts import Step
from clothkit.app.planner import estimate_mesh, load_vtm, mesh_of
from clothkit.app.prebuilt import load_nets
from clothkit.cloth.mesh import error
from clothkit.cloth.silhouette import centred, iou, silhouette
from clothkit.cloth.topology import CLOTH_LENGTH, PAPERS_CLOTH
from clothkit.dataset.export import FORMATS
from clothkit.manipulation.turns import turn_mesh
from clothkit.observation.coverage import goal_iou
from clothkit.observation.pose import Pose
from clothkit.observation.surfaces import check_grid
from clothkit.runtime.errors import InputError
from clothkit.simulation.cloths import simulated_cloths
from clothkit.simulation.executor import execute
from clothkit.simulation.settings import DRAWN, SimulationConfig
from clothkit.simulation.similarity import resized

_BESIDE = 0.1
"""Largest distance of a grasp from the cloth [cloth sides]. Later steps grasp predicted cloth, which is not exact."""

Mesh = Float[np.ndarray, "u v 3"]


class Score(NamedTuple):
    """How near an outcome is to a goal."""

    error: float | None
    """Error [cloth length], aligned, smallest over the equivalents; None if the goal is no mesh."""
    iou: float
    """Intersection over union of the centred silhouettes."""


@click.command()
@click.option(
    "--state",
    metavar="FILE",
    help="The cloth before the plan; of what is no mesh [32, 32, 3] the estimate is simulated. "
    "[default: what the plan took it for]",
)
@click.option("--plan", "source", required=True, type=click.Path(path_type=Path), metavar="PLAN", help="A plan file.")
@click.option(
    "--goal", metavar="FILE|NAME", help="What the outcome is held against: a file, or a name of clothkit goals."
)
@with_variant_options
@click.option("--steps", type=click.IntRange(1, 3), help="Only the first so many steps. [default: all]")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("mesh.glb"),
    show_default=True,
    metavar="FILE",
    help=f"The outcome: {', '.join(FORMATS)}.",
)
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    default=Path("data"),
    show_default=True,
    help="Folder of nets, as in clothkit plan.",
)
@with_observation_options
def command(
    *,
    state: str | None,
    source: Path,
    goal: str | None,
    turn: str | None,
    mirror: bool | None,
    steps: int | None,
    out: Path,
    data: Path,
    mask: str | None,
    **values: Any,
) -> None:
    """Simulate a plan: hands grasp where the plan says, in metres, and move as it says, without a look in between.

    A mesh [32, 32, 3] lies in the table's frame, which a plan in a camera's frame knows too. The outcome is in metres
    in the table's frame. With a goal, its error (mean distance of vertices, moved to fit,
    under any labels) and its silhouette IoU are told, and the start's beside them. The simulated cloth has the sides
    and the thickness of yours, and the settings' material, by default a soft cotton. A named goal lies as it lay for
    the plan, if that was for it, else as the start lies.

    \b
    clothkit simulate --state start.obj --plan plan.json --goal goal.obj --out outcome.glb
    """
    plan = read_plan(source)
    if steps and steps > len(plan.steps):
        raise InputError(f"--steps: {source} has {len(plan.steps)}, found {steps}")
    # A thicker cloth than that of the plan may be tried; one of other sides would begin stretched.
    thickness = values.pop("thickness")
    values |= cloth_of(plan, values, source)
    data, settings = load_nets(data, values)
    values |= {} if thickness is None else {"thickness": thickness}
    options = observation_options(settings.app, **values)
    check_target(out, FORMATS)
    named, angle = goal_option(goal, turn, mirror)
    variant = variant_before(named, plan, source, angle, mirror) if named else None
    keep_compiled_programs()
    with part("observe"):
        start = read_input(state, options, mask=mask) if state else None
        goal_input = read_input(goal, options) if goal and not named else None
    mesh, pose = (mesh_of(start), start.pose) if start else _start(plan, source)
    if mesh is None and start:
        with part("estimate"):
            mesh = np.asarray(estimate_mesh(load_vtm(data), start, settings).mesh[0])
        warn(compare_estimate(start, mesh, settings))
    assert mesh is not None
    # If the cloth is crammed into a point, each vertex touches all others, and one simulation step takes minutes.
    name = state or f"{source}: start.state"
    check_grid(name, mesh * pose.scale, options.topology, side=plan.side_m, unit="m")
    if named:
        with part("make the goal"):
            goal_input = named_goal(
                named, variant or variant_of(angle, mirror, mesh, options.topology), options, settings
            )
        tell(goal_input.notices)
    simulation, notices = simulated_material(settings.simulation, options.cloth, side=options.sides[0])
    tell(notices)
    with part("simulate"):
        hands = start.pose if start and start.kind == "points" and plan.frame == "camera" else None
        states = simulate_plan(
            plan, mesh, pose, simulation, steps=steps, hands=hands, cloth=options.cloth, name=str(source)
        )
    write_mesh(out, states[-1].astype(float) * pose.scale)
    done = sum(not step.null for step in plan.steps[:steps])
    click.echo(f"{out}: the cloth after {done} manipulation{'' if done == 1 else 's'}")
    if start:
        click.echo(f"{start.file}: {'taken as it is' if mesh_of(start) is not None else 'its mesh is estimated'}")
    if goal_input is not None:
        matrix = None if plan.turned is None else np.array(plan.turned)
        before, after = (score(state, goal_input, matrix) for state in (states[0], states[-1]))
        if before.error is not None and after.error is not None:
            unit = CLOTH_LENGTH * pose.scale * 1000
            expected = plan.expected.error_m if len(states) > len(plan.steps) else None
            click.echo(
                f"error {after.error * unit:.0f} mm ({after.error:.3f} cloth lengths), "
                f"before {before.error * unit:.0f} mm"
                + ("" if expected is None else f", expected {expected * 1000:.0f} mm")
            )
        click.echo(f"silhouette IoU {after.iou:.2f}, before {before.iou:.2f}")


def simulated_material(
    settings: SimulationConfig, cloth: Float[np.ndarray, "3"], *, side: float
) -> tuple[SimulationConfig, tuple[str, ...]]:
    """Return the settings for a cloth whose longer side is `side` [m], and notices of what they can't do.

    `cloth` are its sides and thickness [normalised].
    """
    size = side / settings.cloth_side
    # A tiny difference would change the outcome by as much as other rounding does, for nothing.
    found = settings if abs(size - 1) < 1e-6 else replace(settings, material=resized(settings.material, size))
    told = float(cloth[2]) * side / CLOTH_LENGTH
    able = float(simulated_cloths(cloth[None], settings).material[0, DRAWN.index("thickness")]) * size
    if abs(able / told - 1) < 0.01:
        return found, ()
    return found, (
        f"a cloth of {1000 * told:.1f} mm is simulated {1000 * able:.1f} mm thick, which is as near as the simulator's "
        "grid and solver can",
    )


def simulate_plan(
    plan: Plan,
    mesh: Mesh,
    pose: Pose,
    settings: SimulationConfig,
    *,
    steps: int | None = None,
    hands: Pose | None = None,
    cloth: Float[np.ndarray, "3"] = PAPERS_CLOTH,
    name: str,
) -> list[Mesh]:
    """Return the cloth before the first step of a plan and after each step, at its place on the table [normalised].

    `mesh` [normalised, centred] lies at `pose`. Only the first `steps` are simulated, if that is given. `hands` is the
    pose that converts the plan's positions to the table's frame (default: the plan's own). `cloth` are the cloth's
    sides and thickness [normalised]. Raises InputError when a
    hand grasps beside the cloth, or an outcome is not finite.
    """
    centre = pose.centre / pose.scale
    states = [(mesh + np.append(centre, 0)).astype(np.float32)]
    for number, step in enumerate(plan.steps[:steps], start=1):
        if step.null:
            states.append(states[-1])
            continue
        grasps = _grasps(step, hands or plan.pose(plan.start.centre_m))
        beside = np.linalg.norm(states[-1][..., None, :2] - grasps, axis=-1).min((0, 1)).max() / CLOTH_LENGTH
        if beside > _BESIDE:
            raise InputError(
                f"{name}: step {number} grasps {beside:.2f} cloth lengths beside the cloth; is the state in the frame "
                "of the plan?"
            )
        displacement = np.array(step.manipulation[4:], np.float32)
        single = np.array([len(step.hands) == 1])
        world = (states[-1][None], grasps[None], displacement[None], single, simulated_cloths(cloth[None], settings))
        outcome = execute(*world, settings=settings, workers=1)[0]
        if not np.isfinite(outcome).all():
            raise InputError(f"{name}: step {number} has an outcome that is not finite")
        states.append(outcome)
    return states


def _grasps(step: Step, pose: Pose) -> Float[np.ndarray, "2 2"]:
    """Return the hands' grasp points on the table, xy [normalised]; for one hand the same point twice."""
    points = np.array([hand.grasp_m for hand in (step.hands[0], step.hands[-1])], float)
    return (pose.camera_to_table(points)[:, :2] / pose.scale).astype(np.float32)


def _start(plan: Plan, name: Path) -> tuple[Mesh, Pose]:
    """Return the mesh and the pose of the plan's start. Raises InputError if the start is voxels."""
    found = placed_state(plan, plan.start)
    if found.ndim != 3 or found.shape[-1] != 3:
        raise InputError(f"{name}: start: holds voxels, give --state with a mesh, or with what one is estimated from")
    return found, plan.pose(plan.start.centre_m)


def score(state: Mesh, goal: Input, matrix: Float[np.ndarray, "2 2"] | None) -> Score:
    """Compare a state [normalised] with a goal, turned by `matrix` if that is given."""
    mesh, wanted, points = centred(state)[0], mesh_of(goal), goal.observation.points
    if matrix is not None:
        points = np.concatenate([points[:, :2] @ matrix.T.astype(np.float32), points[:, 2:]], axis=1)
    if wanted is None:
        return Score(None, goal_iou(mesh, points))
    if matrix is not None:
        wanted = np.asarray(turn_mesh(jnp.asarray(wanted), jnp.asarray(matrix, jnp.float32)))
    off = float(error(mesh, wanted, aligned=True, cloth=goal.cloth))
    return Score(off, iou(silhouette(mesh), silhouette(centred(wanted)[0])))
