"""`clothkit predict`: predict the states that a plan leads to."""

from pathlib import Path
from typing import Any

import click
import numpy as np

from clothkit.app.agreement import compare_state, warn
from clothkit.app.describe import poses_of
from clothkit.app.inputs import keep_compiled_programs, read_input
from clothkit.app.options import observation_options, with_observation_options
from clothkit.app.output import check_target, part, write_arrays, write_mesh
from clothkit.app.plan_arrays import check_nets, cloth_of, manipulations, placed_state, traces_before
from clothkit.app.plan_file import read_plan
from clothkit.app.planner import begin, load_planner, observation_of, predict_plan
from clothkit.app.prebuilt import load_nets
from clothkit.cloth.mesh import distance_aligned
from clothkit.planning import agent
from clothkit.planning.systems import system
from clothkit.runtime.errors import InputError
from clothkit.runtime.publish import unfinished_files


@click.command()
@click.option("--state", required=True, metavar="FILE", help="The cloth as it lies before the plan.")
@click.option("--plan", "source", required=True, type=click.Path(path_type=Path), metavar="PLAN", help="A plan file.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("predicted"), show_default=True, metavar="FOLDER")
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    default=Path("data"),
    show_default=True,
    help="Folder of nets, as in clothkit plan.",
)
@with_observation_options
def command(*, state: str, source: Path, out: Path, data: Path, mask: str | None, **values: Any) -> None:
    """Predict what a plan makes of a cloth: a mesh for each step and net, with how sure the net is.

    The folder gets step_N_net_X.obj, in metres in the table's frame, and beside each an NPZ with mean and sigma
    [u, v, xyz] in metres; of systems that plan in voxels the NPZ alone, with their occupancy. The state may be another
    than the one that was planned for: its grasp points are where they are on the cloth.

    \b
    clothkit predict --state start.obj --plan plan.json --out predicted
    """
    plan = read_plan(source)
    values |= cloth_of(plan, values, source)
    data, settings = load_nets(data, values if plan.system == "main" else None)
    options = observation_options(settings.app, **values)
    chosen = system(plan.system)
    nets = [prediction.net for prediction in plan.steps[0].predictions]
    _check_folder(out, [f"step_{step + 1}_net_{net}" for step in range(len(plan.steps)) for net in nets])
    keep_compiled_programs()
    with part("observe"):
        start_input = read_input(state, options, mask=mask)
    with part("load nets"):
        planner = load_planner(chosen, data, settings)
        check_nets(plan, planner, data, source)
        traces = traces_before(plan, planner, source)
    with part("predict"):
        start = placed_state(plan, plan.start)
        # The plan's grasp points are in the labels of its start, so the state needs the same labels.
        memory = begin(planner, start, len(plan.steps), start_input.cloth)
        if not chosen.voxels:
            memory = memory._replace(planned=np.ones(1, bool), expected=start[None].astype(np.float32))
        observation = observation_of(planner, start_input, data, settings)
        cloth = agent.perceive(planner, observation, memory)[0][0]
        estimate = compare_state(chosen, start_input, cloth, settings)
        found = predict_plan(
            planner,
            cloth,
            manipulations(plan),
            common=plan.memory.common,
            traces=traces,
            cloth=start_input.cloth,
        )
    warn(estimate)
    with unfinished_files(out) as unfinished:
        for step, pose in enumerate(poses_of(found, start_input.pose)[1:]):
            for number, net in enumerate(nets):
                name, mean = f"step_{step + 1}_net_{net}", found.means[number, step]
                if found.stds is None:
                    write_arrays(unfinished / f"{name}.npz", {"occupancy": mean.astype(np.float32)})
                    continue
                placed = pose.normalised_to_table(mean.astype(float))
                sigma = found.stds[number, step].astype(float) * pose.scale
                write_mesh(unfinished / f"{name}.obj", placed)
                arrays = {"mean": placed.astype(np.float32), "sigma": sigma.astype(np.float32)}
                write_arrays(unfinished / f"{name}.npz", arrays)
    click.echo(f"{out}: {len(plan.steps)} step{'s' if len(plan.steps) > 1 else ''}, nets {', '.join(map(str, nets))}")
    if not chosen.voxels:
        apart = float(distance_aligned(cloth, start))
        click.echo(f"the state differs by {apart:.3f} cloth lengths from the one that was planned for")


def _check_folder(path: Path, names: list[str]) -> None:
    """Check, before any work is done, that the files can be written. Raises InputError."""
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is a file, expected a folder")
    if path.is_dir():
        for name in names:
            for ending in ("obj", "npz"):
                check_target(path / f"{name}.{ending}", (ending,))
