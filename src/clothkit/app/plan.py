"""`clothkit plan`: make a plan from one observation to a goal, and write the plan file."""

import os
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Literal

import click

from clothkit.app.advice import unsure_in_words
from clothkit.app.agent import Agent
from clothkit.app.agreement import warn
from clothkit.app.confirm import asks, confirm_goal
from clothkit.app.describe import Frame
from clothkit.app.inputs import Input, keep_compiled_programs, read_input, tell
from clothkit.app.lengths import AUTO, Steps, choice_in_words
from clothkit.app.named_goals import goal_option, manipulations_of, variant_before, with_variant_options
from clothkit.app.options import observation_options, with_observation_options
from clothkit.app.output import check_target, part
from clothkit.app.plan_arrays import cloth_of, steps_left
from clothkit.app.plan_file import Plan, read_plan, write_plan
from clothkit.app.plan_parts import Source
from clothkit.app.planner import load_planner
from clothkit.app.prebuilt import load_nets
from clothkit.app.reach import limits_of
from clothkit.dataset.store import STEPS
from clothkit.manipulation.named_folds import GOALS
from clothkit.planning.optimisers import OPTIMISERS, optimiser_of
from clothkit.planning.systems import SYSTEMS, System, system
from clothkit.planning.trust import NEAR
from clothkit.runtime.errors import InputError


@click.command(short_help="A plan that brings a cloth into a given shape.")
@click.option("--state", required=True, metavar="FILE", help="The cloth as it lies.")
@click.option(
    "--goal",
    required=True,
    metavar="FILE|NAME",
    help="The shape that it shall have, wherever it lies: a file, or a name of clothkit goals, such as half.",
)
@with_variant_options
@click.option(
    "--steps",
    type=Steps(),
    metavar="N|auto",
    help="Manipulations, 1 to 3; auto: as many as are worth it, none if the cloth is the goal already. Required if the "
    "goal is a file and there is no --after. [default: what a named goal needs; with --after what is left of it]",
)
@click.option("--out", type=click.Path(path_type=Path), default=Path("plan.json"), show_default=True, metavar="FILE")
@click.option(
    "--after",
    type=click.Path(path_type=Path),
    metavar="PLAN",
    help="The plan whose first step has been executed and led to this state: goes on with its later steps, labels and "
    "memory. It has two steps or three, with --steps auto any number.",
)
@click.option(
    "--system",
    "name",
    type=click.Choice(list(SYSTEMS)),
    help="What plans: main estimates a mesh from what a camera sees; b1 takes a mesh as it is; b2 plans with the best "
    "net alone; b3 does not mind uncertainty; b4, b5 plan in voxels, with all nets and one; unrefined takes estimates "
    "as they come. [default: b1 for a mesh [32, 32, 3], main for all else]",
)
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    default=Path("data"),
    show_default=True,
    metavar="FOLDER",
    help="Where nets/ and normalisation/ are, as dvc repro makes them, or a folder of prebuilt nets. While the default "
    "folder has no nets, those of prebuilt/household are taken.",
)
@click.option(
    "--optimiser",
    type=click.Choice(list(OPTIMISERS)),
    help="What searches for the plan: that of params.yaml with its settings (default), another with its usual ones.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Same seed, same plan.")
@click.option(
    "--frame",
    type=click.Choice(["camera", "table"]),
    default="camera",
    show_default=True,
    help="Of the plan's positions: that of the state's points, or the table's (z up). Meshes and voxels are in the "
    "table's.",
)
@click.option(
    "--reach",
    type=float,
    nargs=6,
    multiple=True,
    metavar="X Y Z X Y Z",
    help="Low and high corner of the box that the hands reach, metres in the table's frame; given twice, each hand has "
    "its own. A plan that leaves it is turned or mirrored, where this cloth looks the same turned; its goal turns "
    "along. If that does not help, another plan is searched for.",
)
@click.option(
    "--reach-ball",
    type=float,
    nargs=4,
    multiple=True,
    metavar="X Y Z R",
    help="The same as a ball: centre and radius, metres in the table's frame. Balls come after boxes, if each hand has "
    "its own.",
)
@click.option(
    "--keep-out",
    type=float,
    nargs=6,
    multiple=True,
    metavar="X Y Z X Y Z",
    help="Low and high corner of a box that no hand may enter, metres in the table's frame; may be repeated, and "
    "replaces app.keep_out.",
)
@click.option("--apart", type=float, metavar="METRES", help="Least distance between two hands. [default: app.apart, 0]")
@click.option(
    "--confirm/--no-confirm",
    default=None,
    help="Before the search, draw the goal as it was seen and what it is taken for, beside --out (plan.goal.png), and "
    "ask whether that is right. [default: on a terminal, for a goal that a camera saw]",
)
@with_observation_options
def command(
    *,
    state: str,
    goal: str,
    steps: int | Literal["auto"] | None,
    out: Path,
    after: Path | None,
    name: str | None,
    data: Path,
    optimiser: str | None,
    seed: int,
    frame: Frame,
    reach: tuple[tuple[float, ...], ...],
    reach_ball: tuple[tuple[float, ...], ...],
    keep_out: tuple[tuple[float, ...], ...],
    apart: float | None,
    turn: str | None,
    mirror: bool | None,
    confirm: bool | None,
    mask: str | None,
    **values: Any,
) -> None:
    """Plan how two hands bring a cloth into a given shape.

    STATE and GOAL are files: a mesh (OBJ, PLY, GLB in metres; NPY, NPZ normalised; data/meshes.zarr:SEQUENCE/STATE),
    voxels [32, 32, 16] (NPY, NPZ, zarr), or a point cloud in metres (PLY without faces, PCD, NPY, NPZ) with what tells
    its cloth from the table: a mask, the table's colour, or its plane if nothing but the cloth is there. GOAL may be
    the name of a folded shape, too (clothkit goals): it is made of your cloth in the simulator, and lies as your cloth
    lies.

    The plan is JSON (docs/plan.schema.json): for each step grasp and release points and timed waypoints of each hand,
    the predicted states of each net, the expected error and how unsure the nets are. If nothing is expected to come
    of it, it says so.

    With --steps auto, plans of each length are searched for, and that is taken whose number of manipulations is worth
    it (app.length in params.yaml); none, if the cloth is as near to its goal as it is expected to get.

    A plan is made once, from one observation. Cloths do not do quite what nets predict: execute the first step,
    observe, and plan again for the steps that are left, with --after.

    \b
    clothkit plan --state cloud.ply --goal goal.obj --steps 2 --table 0 0 -1 -0.8
    clothkit plan --state cloud.ply --goal half --sides 0.5 0.3 --table 0 0 -1 -0.8
    clothkit plan --state cloud2.ply --goal goal.obj --after plan.json --out plan2.json --table 0 0 -1 -0.8
    """
    check_target(out, ("json",))
    # Path.resolve fails where links lead in a circle.
    if after and os.path.realpath(out) == os.path.realpath(after):
        raise InputError(f"--out: {out} is what --after reads, expected another file")
    previous = read_plan(after) if after else None
    if previous and after:
        values |= cloth_of(previous, values, after)
    # Prebuilt nets are those of system main alone.
    planning = name or (previous.system if previous else "main")
    data, settings = load_nets(data, values if planning == "main" else None)
    options = observation_options(settings.app, **values)
    limits = limits_of(settings.app, boxes=reach, balls=reach_ball, keep_out=keep_out, apart=apart)
    named, angle = goal_option(goal, turn, mirror)
    length = _length(steps, previous, after, named)
    if named:
        variant_before(named, previous, after, angle, mirror)
    keep_compiled_programs()
    with part("observe"):
        start = read_input(state, options, mask=mask)
        goal_input = None if named else read_input(goal, options)
    chosen = _system(name, start, previous, after)
    with part("load nets"):
        planner = load_planner(chosen, data, settings, optimiser=optimiser)
        agent = Agent.of(planner, settings, options, frame=frame, limits=limits)
    with part("make the goal") if named else nullcontext():
        agent.begin(goal_input or goal, length, turn=angle, mirror=mirror, after=after)
    with part("estimate"):
        agent.observe(start)
    if named:
        tell(agent.state.goal.notices)
    if confirm is None:
        confirm = asks(agent.state.goal, agent.agreements[1])
    if confirm:
        confirm_goal(out, agent.state.goal, agent.state.target, agent.agreements[1])
    with part(f"search by {optimiser_of(planner.settings.search.optimiser).name}"):
        plan = agent.plan(seed=seed)
    for estimate in agent.agreements:
        warn(estimate)
    told = {*start.notices, *agent.state.goal.notices, *(found.sentence for found in agent.agreements if found)}
    tell(tuple(notice for notice in plan.notices if notice not in told))
    write_plan(out, plan)
    click.echo(summary(plan, out))
    planned = agent.state.planned
    if planned is not None and planned.choice is not None:
        click.echo(choice_in_words(planned.choice, options.side))


def _length(
    steps: int | Literal["auto"] | None, previous: Plan | None, after: Path | None, named: str | None
) -> int | Literal["auto"]:
    if steps == AUTO:
        return steps
    if previous is not None and after is not None:
        return steps_left(previous, after, steps)
    if steps is not None:
        return steps
    if named is None:
        raise click.UsageError("Missing option '--steps': how many manipulations, 1 to 3.")
    needed = GOALS[named].manipulations
    if needed > STEPS:
        click.echo(
            f"notice: {named} needs {needed} manipulations, and a plan has at most {STEPS}: execute its first step, "
            "look, and plan anew",
            err=True,
        )
    return manipulations_of(named)


def _system(name: str | None, start: Input, previous: Plan | None, after: Path | None) -> System:
    if previous is not None:
        if name not in (None, previous.system):
            raise InputError(f"--system: expected {previous.system}, with which {after} was planned, found {name}")
        name = previous.system
    return system(name or ("b1" if start.kind == "mesh" else "main"))


def summary(plan: Plan, path: Path) -> str:
    """Return the lines that the command prints about a plan."""
    lines = [f"{path}: {len(plan.steps)} step{'s' if len(plan.steps) > 1 else ''}, in the {plan.frame}'s frame"]
    for number, step in enumerate(plan.steps, start=1):
        if step.null:
            lines.append(f"  step {number}: nothing to do")
            continue
        moves = [f"{_point(hand.grasp_m)} -> {_point(hand.release_m)}" for hand in step.hands]
        lines.append(f"  step {number}: {', '.join(moves)} m in {step.hands[0].waypoints[-1].time_s:.1f} s")
    lines += [f"{source.file}: {_usage_in_words(source)}" for source in (plan.state, plan.goal)]
    for what, source in (("state", plan.state), ("goal", plan.goal)):
        if source.agreement is not None:
            lines.append(
                f"the {what}'s estimate {'explains' if source.agreement.explains else 'does not explain'} what was "
                f"seen: silhouette IoU {source.agreement.silhouette_iou:.2f}, height IoU "
                f"{source.agreement.height_iou:.2f}"
                f"{'' if source.agreement.known else '; the net has seen nothing like this'}"
            )
    unsure = plan.state.unsure
    if unsure is not None:
        sure = f"sigma is nowhere above {1000 * unsure.threshold_m:.0f} mm: no part of the state's estimate is poor"
        lines.append(unsure_in_words(unsure) if unsure.share else sure)
    expected = plan.expected
    if expected.error_m is not None and expected.error_no_action_m is not None:
        lines.append(
            f"expected error {expected.error_m * 1000:.0f} mm ({expected.error_cloth_lengths:.3f} cloth lengths), "
            f"{expected.error_no_action_m * 1000:.0f} mm if nothing is done"
        )
    else:
        lines.append(
            f"expected voxel error {expected.voxel_error:.4f}, {expected.voxel_error_no_action:.4f} if nothing is done"
        )
    if (
        expected.outcome_error_m is not None
        and expected.outcome_error_low_m is not None
        and expected.outcome_error_high_m is not None
        and expected.trust is not None
    ):
        low, high = expected.outcome_error_low_m * 1000, expected.outcome_error_high_m * 1000
        lines.append(
            f"such plans ended {expected.outcome_error_m * 1000:.0f} mm from their goals, 80 % of them {low:.0f} to "
            f"{high:.0f} mm; trust {expected.trust:.2f}: the share that ended within {NEAR:g} cloth lengths"
        )
    lines.append(
        f"silhouette IoU {expected.silhouette_iou:.2f}, {expected.silhouette_iou_no_action:.2f} if nothing is done"
    )
    unknown = []
    if expected.prediction_error_m is not None:
        unknown.append(f"the predicted outcome is expected to be {1000 * expected.prediction_error_m:.0f} mm off")
    if expected.epistemic_uncertainty is not None:
        unknown.append(f"epistemic uncertainty u = {expected.epistemic_uncertainty:.3g}")
    apart = [step.disagreement_m for step in plan.steps if step.disagreement_m is not None]
    if apart:
        unknown.append(f"the nets differ by {', '.join(f'{1000 * d:.0f}' for d in apart)} mm")
    if unknown:
        lines.append(", ".join(unknown))
    if expected.error_without_limits_m is not None:
        lines.append(
            f"to keep within the limits of the hands, another plan was searched for; without them "
            f"{expected.error_without_limits_m * 1000:.0f} mm were expected"
        )
    if plan.turned:
        lines.append("the plan was turned or mirrored to be in reach, and so is the shape that it leads to")
    if plan.warning:
        lines.append(plan.warning)
    return "\n".join(lines)


def _usage_in_words(source: Source) -> str:
    """Say whether the plan uses a file's content as it is or an estimate of it."""
    if source.taken == "estimated":
        return f"its mesh is estimated from {'its voxels' if source.kind == 'voxels' else 'what is seen of it'}"
    return "taken as it is"


def _point(point: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{value:.3f}" for value in point) + ")"
