"""Cloth states as mesh files, or as a dataset of a known format: `clothkit export data/raw --all --format lerobot`.

From raw artifacts (any topology) or from `data/meshes.zarr` (32 x 32). `python -m clothkit.app.export` does the same,
and takes sequences as `--sequence 3 7`.
"""

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import click
import numpy as np

from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.dataset.export import FORMATS, check_side, export
from clothkit.dataset.lerobot import Draw, write_lerobot
from clothkit.dataset.recorded import Recorded, read_recorded
from clothkit.report.card.hub import write_hub
from clothkit.report.draw import draw
from clothkit.runtime.errors import InputError, untold_error
from clothkit.runtime.publish import unfinished_files
from clothkit.simulation.settings import SimulationConfig

DATASETS = ("lerobot", "huggingface")
"""Formats of whole datasets, which need a new folder."""

_EVERY = ", ".join((*FORMATS, *DATASETS))
_PICTURES = "lerobot: with pictures of the states from above, of so many pixels a side"


@click.command()
@click.argument("source", type=click.Path(path_type=Path))
@click.option("--sequence", "sequences", type=int, multiple=True, metavar="N", help="One of them; may be repeated.")
@click.option("--all", "every", is_flag=True, help="All sequences.")
@click.option("--format", "file_format", default="glb", show_default=True, help=f"{_EVERY}.")
@click.option("--to", type=click.Path(path_type=Path), default=Path("exported"), show_default=True, metavar="FOLDER")
@click.option(
    "--cloth-side",
    type=float,
    default=SimulationConfig().cloth_side,
    show_default=True,
    metavar="METRES",
    help="Of meshes in a store.",
)
@click.option("--pictures", type=click.IntRange(16, 1024), metavar="PIXELS", help=f"{_PICTURES}.")
def command(
    source: Path,
    *,
    sequences: tuple[int, ...],
    every: bool,
    file_format: str,
    to: Path,
    cloth_side: float,
    pictures: int | None,
) -> None:
    """Write states of SOURCE as files that other programs open, in metres, with texture coordinates.

    SOURCE is a folder of raw artifacts (data/raw) or a store of meshes (data/meshes.zarr). OBJ and PLY have z up, GLB y
    up. The formats lerobot and huggingface make a dataset of all chosen sequences, in a new folder that can be
    uploaded as it is.

    \b
    clothkit export data/raw --sequence 3 --sequence 7 --format glb --to exported
    clothkit export data/meshes.zarr --all --format lerobot --to cloths
    """
    if every == bool(sequences):
        raise click.UsageError("expected either --sequence N or --all")
    _export(source, to, file_format, None if every else sequences, cloth_side, pictures)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments to a parser."""
    parser.add_argument("source", type=Path, help="a folder of raw artifacts (data/raw) or a store (data/meshes.zarr)")
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--sequence", type=int, nargs="+", metavar="N", help="numbers of the sequences")
    which.add_argument("--all", action="store_true", help="every sequence")
    parser.add_argument("--format", default="glb", help=f"{_EVERY}; glb is y up, the others z up")
    parser.add_argument("--to", type=Path, default=Path("exported"), metavar="FOLDER", help="made when it isn't there")
    side = SimulationConfig().cloth_side
    parser.add_argument(
        "--cloth-side", type=float, default=side, metavar="M", help=f"metres, of meshes in a store ({side})"
    )
    parser.add_argument("--pictures", type=int, metavar="PIXELS", help=_PICTURES)


def run(arguments: argparse.Namespace) -> None:
    """Write the files and print where they are. Raises InputError."""
    sequences = None if arguments.all else arguments.sequence
    _export(arguments.source, arguments.to, arguments.format, sequences, arguments.cloth_side, arguments.pictures)


def _export(
    source: Path,
    to: Path,
    file_format: str,
    sequences: Sequence[int] | None,
    cloth_side: float,
    pictures: int | None,
) -> None:
    if pictures is not None and file_format != "lerobot":
        raise InputError(f"pictures are part of format lerobot alone, found {file_format}")
    if file_format in FORMATS:
        written = export(source, to, file_format=file_format, sequences=sequences, cloth_side=cloth_side)
        print(f"{len(written)} files in {to}: {written[0].name} to {written[-1].name}")
        return
    if file_format not in DATASETS:
        raise InputError(f"format {file_format!r} is not known; known are {_EVERY}")
    check_side(cloth_side)
    if to.is_dir() and any(to.iterdir()):
        raise InputError(f"{to}: is there already; a dataset of format {file_format} needs a new or an empty folder")
    with unfinished_files(to) as part:
        if file_format == "lerobot":
            recorded = read_recorded(source, sequences, cloth_side=cloth_side)
            write_lerobot(part, recorded, draw=_drawing(source, pictures))
        else:
            write_hub(part, source, sequences)
        count = sum(path.is_file() for path in part.rglob("*"))
    print(f"{count} files in {to}, a dataset of format {file_format}")


def _drawing(source: Path, pixels: int | None) -> Draw | None:
    """Draws each state of a sequence from above, on the whole table."""
    if pixels is None:
        return None

    def pictures(recorded: Recorded) -> Iterator[np.ndarray]:
        side = math.isqrt(recorded.vertices.shape[1])
        if side**2 != recorded.vertices.shape[1]:
            raise InputError(
                f"{source}: sequence {recorded.sequence} has {recorded.vertices.shape[1]} vertices, expected a square "
                "grid of them for pictures; export data/meshes.zarr, or leave out --pictures"
            )
        scale = CLOTH_LENGTH / float(recorded.cloth[:2].max())
        for vertices in recorded.vertices:
            yield draw((vertices * np.float32(scale)).reshape(side, side, 3), pixels=pixels)

    return pictures


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command. Bad input ends it with one sentence and exit status 1."""
    about = "Cloth states as files of meshes, or a dataset of them."
    parser = argparse.ArgumentParser(prog="clothkit.app.export", description=about)
    add_arguments(parser)
    try:
        run(parser.parse_args(argv))
    except InputError as error:
        sys.exit(f"export: {error}")
    except OSError as error:
        sys.exit(f"export: {untold_error(error) or error}")


if __name__ == "__main__":
    main()
