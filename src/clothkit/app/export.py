"""Cloth states as OBJ, PLY or GLB files: `clothkit export data/raw --sequence 3 --format glb --to out`.

From raw artifacts (any topology) or from `data/meshes.zarr` (32 x 32). `python -m clothkit.app.export` does the same,
and takes sequences as `--sequence 3 7`.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import click

from clothkit.dataset.export import FORMATS, export
from clothkit.runtime.errors import InputError, untold_error
from clothkit.simulation.settings import SimulationConfig


@click.command()
@click.argument("source", type=click.Path(path_type=Path))
@click.option("--sequence", "sequences", type=int, multiple=True, metavar="N", help="One of them; may be repeated.")
@click.option("--all", "every", is_flag=True, help="All sequences.")
@click.option("--format", "file_format", default="glb", show_default=True, help=f"{', '.join(FORMATS)}.")
@click.option("--to", type=click.Path(path_type=Path), default=Path("exported"), show_default=True, metavar="FOLDER")
@click.option(
    "--cloth-side",
    type=float,
    default=SimulationConfig().cloth_side,
    show_default=True,
    metavar="METRES",
    help="Of meshes in a store.",
)
def command(
    source: Path, *, sequences: tuple[int, ...], every: bool, file_format: str, to: Path, cloth_side: float
) -> None:
    """Write states of SOURCE as files that other programs open, in metres, with texture coordinates.

    SOURCE is a folder of raw artifacts (data/raw) or a store of meshes (data/meshes.zarr). OBJ and PLY have z up, GLB y
    up.

    \b
    clothkit export data/raw --sequence 3 --sequence 7 --format glb --to exported
    """
    if every == bool(sequences):
        raise click.UsageError("expected either --sequence N or --all")
    _export(source, to, file_format, None if every else sequences, cloth_side)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments to a parser."""
    parser.add_argument("source", type=Path, help="a folder of raw artifacts (data/raw) or a store (data/meshes.zarr)")
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--sequence", type=int, nargs="+", metavar="N", help="numbers of the sequences")
    which.add_argument("--all", action="store_true", help="every sequence")
    parser.add_argument("--format", default="glb", help=f"{', '.join(FORMATS)}; glb is y up, the others z up")
    parser.add_argument("--to", type=Path, default=Path("exported"), metavar="FOLDER", help="made when it isn't there")
    side = SimulationConfig().cloth_side
    parser.add_argument(
        "--cloth-side", type=float, default=side, metavar="M", help=f"metres, of meshes in a store ({side})"
    )


def run(arguments: argparse.Namespace) -> None:
    """Write the files and print where they are. Raises InputError."""
    sequences = None if arguments.all else arguments.sequence
    _export(arguments.source, arguments.to, arguments.format, sequences, arguments.cloth_side)


def _export(source: Path, to: Path, file_format: str, sequences: Sequence[int] | None, cloth_side: float) -> None:
    written = export(source, to, file_format=file_format, sequences=sequences, cloth_side=cloth_side)
    print(f"{len(written)} files in {to}: {written[0].name} to {written[-1].name}")


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command. Bad input ends it with one sentence and exit status 1."""
    parser = argparse.ArgumentParser(prog="clothkit.app.export", description="Cloth states as OBJ, PLY or GLB files.")
    add_arguments(parser)
    try:
        run(parser.parse_args(argv))
    except InputError as error:
        sys.exit(f"export: {error}")
    except OSError as error:
        sys.exit(f"export: {untold_error(error) or error}")


if __name__ == "__main__":
    main()
