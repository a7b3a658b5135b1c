"""`clothkit goals`: the named goals, with pictures of how they are folded."""

import re
from pathlib import Path

import click

from clothkit.app.named_goals import TURNS, with_variant_options, world_of
from clothkit.app.options import observation_options, with_cloth_options
from clothkit.app.output import check_target, part, write_mesh
from clothkit.app.prebuilt import load_nets
from clothkit.dataset.export import FORMATS
from clothkit.goals.store import made_all, named, user_folder
from clothkit.goals.variants import Variant, base, image, placed
from clothkit.manipulation.named_folds import GOALS, Goal
from clothkit.report.figures.goals import Folded, goals
from clothkit.runtime.errors import InputError
from clothkit.runtime.publish import unfinished, unfinished_files


@click.command(short_help="Named goals, with pictures.")
@click.argument("names", nargs=-1, metavar="[NAME]..")
@click.option("--list", "only_list", is_flag=True, help="List the names alone: nothing is simulated.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("goals.png"),
    show_default=True,
    metavar="FILE",
    help="A picture of how each is folded: png.",
)
@click.option(
    "--meshes", type=click.Path(path_type=Path), metavar="FOLDER", help="Also write each goal as FOLDER/NAME.FORMAT."
)
@click.option("--format", "file_format", type=click.Choice(FORMATS), default="obj", show_default=True)
@with_variant_options
@with_cloth_options
def command(
    *,
    names: tuple[str, ...],
    only_list: bool,
    out: Path,
    meshes: Path | None,
    file_format: str,
    turn: str | None,
    mirror: bool | None,
    side: float | None,
    sides: tuple[float, float] | None,
    thickness: float | None,
) -> None:
    """List the folded shapes that `clothkit plan --goal` knows by name, and show how each is folded.

    They are made of your cloth in the simulator and kept, so that the first call takes minutes and later ones a second.
    NAMEs choose some of them. The cloth's longer side runs along x.

    \b
    clothkit goals --list
    clothkit goals half quarter --sides 0.5 0.3 --thickness 0.004 --out towel.png --meshes towel
    """
    chosen = [named(name) for name in dict.fromkeys(names or GOALS)]
    if only_list:
        click.echo("\n".join(line(goal) for goal in chosen))
        return
    check_target(out, ("png",))
    _, settings = load_nets(Path("data"), {"side": side, "sides": sides, "thickness": thickness})
    options = observation_options(settings.app, side=side, sides=sides, thickness=thickness)
    simulation, topology = world_of(options, settings.simulation)
    variant = Variant(turn=TURNS[turn or "0"], mirror=bool(mirror))
    with part("make the goals"):
        wanted = [(goal.name, base(topology, variant), simulation) for goal in chosen]
        found = dict(zip(chosen, made_all(wanted, folder=user_folder()), strict=True))
    made = {goal: one for goal, one in found.items() if not isinstance(one, InputError)}
    if not made:
        raise next(one for one in found.values() if isinstance(one, InputError))
    with unfinished(out) as unfinished_out:
        folded = [Folded(goal.name, *image(one, variant)) for goal, one in made.items()]
        goals(folded, unfinished_out)
    if meshes is not None:
        with unfinished_files(meshes) as folder:
            for goal, one in made.items():
                write_mesh(folder / f"{goal.name}.{file_format}", placed(one, variant).astype(float) * options.scale)
    for goal, tried in found.items():
        click.echo(line(goal, tried if isinstance(tried, InputError) else None))
    click.echo(f"{out}: {len(made)} goal{'' if len(made) == 1 else 's'}")
    if meshes is not None:
        click.echo(f"{meshes}: {len(made)} meshes, .{file_format}")


def line(goal: Goal, error: InputError | None = None) -> str:
    """What is told of a goal."""
    # Without the numbers of its references, which stand in the module.
    source = re.sub(r" \[\d\]", "", goal.source)
    told = f"{goal.name:<21} {goal.manipulations}  {goal.summary}{f' ({source})' if source else ''}"
    return told if error is None else f"{told}; not of this cloth: {error}"
