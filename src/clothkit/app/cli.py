"""The command `clothkit`."""

import importlib
from typing import Any

import click

from clothkit.runtime.errors import InputError, untold_error

COMMANDS = {
    "plan": "A plan that brings a cloth into a given shape.",
    "estimate": "The mesh that voxels or a point cloud show.",
    "predict": "What the nets expect of a plan, as meshes.",
    "simulate": "What a plan comes to in the simulator.",
    "bag": "A plan as timed poses of the grippers, for ROS 2.",
    "goals": "Named goals, with pictures.",
    "export": "States as mesh files, or a dataset for LeRobot or the Hugging Face Hub.",
    "view": "A local page on which sessions are played.",
}
"""Help text by command. The command is `command` in the module of that name; help need not import these modules."""


class _BadInput(click.ClickException):
    """Bad input: its sentence goes to stderr as it is, and the exit status is 1."""

    exit_code = 1

    def show(self, file: Any = None) -> None:
        click.echo(self.message, err=True)


class _Commands(click.Group):
    """A group whose commands are imported only when they are called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        found: click.Command = importlib.import_module(f"clothkit.app.{cmd_name}").command
        return found

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except InputError as error:
            raise _BadInput(f"{ctx.invoked_subcommand}: {' '.join(str(error).split())}") from error
        except (click.exceptions.Exit, click.Abort):
            raise
        except Exception as error:
            told = untold_error(error)
            if told is None:
                raise
            raise _BadInput(f"{ctx.invoked_subcommand}: {told}") from error


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="clothkit")
def cli() -> None:
    """Plan how a robot with two hands folds a cloth into any given shape.

    Settings come from params.yaml of the current directory, where there is one (its block `app` is about your cloth,
    camera and robot), and nets from data/, as `dvc repro` makes them, or while there are none, from prebuilt/household.

    \b
    clothkit plan --state cloud.ply --goal goal.obj --steps 2 --table 0 0 -1 -0.8
    clothkit simulate --state cloud.ply --plan plan.json --goal goal.obj --out mesh.glb --table 0 0 -1 -0.8

    `clothkit COMMAND --help` tells more. Bad input ends a command with one sentence and exit status 1, and leaves what
    was written before as it is.
    """


def main() -> None:
    """Entry point of the installed command and of `python -m clothkit`."""
    cli(prog_name="clothkit")
