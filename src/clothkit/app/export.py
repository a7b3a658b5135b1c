"""Cloth states as OBJ, PLY or GLB files: `python -m clothkit.app.export data/raw --sequence 3 --format glb --to out`.

From raw artifacts (any topology) or from `data/meshes.zarr` (32 x 32).
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from clothkit.dataset.export import FORMATS, export
from clothkit.errors import InputError
from clothkit.simulation.settings import SimulationConfig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What the command takes."""
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
    """Write the files and say where they are. Raises InputError."""
    written = export(
        arguments.source,
        arguments.to,
        file_format=arguments.format,
        sequences=None if arguments.all else arguments.sequence,
        cloth_side=arguments.cloth_side,
    )
    print(f"{len(written)} files in {arguments.to}: {written[0].name} to {written[-1].name}")


def main(argv: Sequence[str] | None = None) -> None:
    """The command; bad input ends it with one sentence and exit status 1."""
    parser = argparse.ArgumentParser(prog="clothkit.app.export", description="Cloth states as OBJ, PLY or GLB files.")
    add_arguments(parser)
    try:
        run(parser.parse_args(argv))
    except InputError as error:
        sys.exit(f"export: {error}")


if __name__ == "__main__":
    main()
