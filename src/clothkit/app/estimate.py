"""`clothkit estimate`: estimate a mesh, with standard deviations, from voxels or a point cloud."""

from pathlib import Path
from typing import Any

import click
import numpy as np
from jaxtyping import Bool, Float

from clothkit.app.agreement import compare_estimate
from clothkit.app.inputs import Input, keep_compiled_programs, read_input
from clothkit.app.options import observation_options, with_observation_options
from clothkit.app.output import check_target, part, write_arrays, write_mesh
from clothkit.app.planner import alternatives_of, load_vtm
from clothkit.app.prebuilt import load_nets
from clothkit.cloth.silhouette import silhouette
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.dataset.export import FORMATS
from clothkit.models.hypotheses import Hypotheses
from clothkit.observation.coverage import EXTENT, covered, resolution_for

LEAST = 0.05
"""Shapes with a smaller probability are not written."""


@click.command()
@click.argument("file")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("mesh.obj"),
    show_default=True,
    metavar="FILE",
    help=f"The mesh: {', '.join(FORMATS)}.",
)
@click.option(
    "--sigma",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="NPZ: mesh, mean and sigma [u, v, xyz] in metres. [default: beside --out, ending sigma.npz]",
)
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    default=Path("data"),
    show_default=True,
    help="Folder of nets, as in clothkit plan.",
)
@with_observation_options
def command(file: str, *, out: Path, sigma: Path | None, data: Path, mask: str | None, **values: Any) -> None:
    """Estimate the mesh of the cloth in FILE: voxels, a point cloud, or a mesh as a camera above would see it.

    The net gives a mean and a standard deviation for each coordinate; the mesh is what is plausible within them.
    All are in the table's frame, z up (y up in GLB), the table at 0. If the observation may show several shapes, the
    most probable one is in --out, the others are beside it, numbered from 2: mesh.2.obj.

    \b
    clothkit estimate cloud.ply --table 0 0 -1 -0.8 --out mesh.obj
    """
    data, settings = load_nets(data, values)
    options = observation_options(settings.app, **values)
    check_target(out, FORMATS)
    sigma_path = sigma or out.with_suffix(".sigma.npz")
    check_target(sigma_path, ("npz",))
    keep_compiled_programs()
    with part("observe"):
        source = read_input(file, options, mask=mask)
    with part("estimate"):
        found, meshes = alternatives_of(load_vtm(data), source, settings)
    likely = [float(share) for share in found.probability[0] if share >= LEAST]
    if len(likely) > 1:
        shares = ", ".join(f"{100 * share:.0f} %" for share in likely)
        click.echo(f"{file}: may show {len(likely)} shapes, which have the probabilities {shares}")
    for i in range(len(likely)):
        _write(_numbered(out, i), _numbered(sigma_path, i), source, found, meshes, i)
    agreement = compare_estimate(source, np.asarray(meshes[0, 0], float), settings)
    click.echo(f"{'' if agreement.reliable else 'warning: '}{agreement.sentence}")


def _write(out: Path, sigma_path: Path, source: Input, found: Hypotheses, meshes: Any, i: int) -> None:
    """Write shape i and its standard deviations, and print what it covers."""
    mesh, mean, std = (np.asarray(part[0, i], float) for part in (meshes, *found.mesh))
    place, scale = source.pose.normalised_to_table, source.pose.scale
    write_mesh(out, place(mesh))
    arrays = {"mesh": place(mesh), "mean": place(mean), "sigma": std * scale}
    write_arrays(sigma_path, {name: array.astype(np.float32) for name, array in arrays.items()})
    unit = (CLOTH_LENGTH * scale) ** 2 * 1e4
    click.echo(
        f"{out}: sigma {1000 * scale * std.mean():.1f} mm on average (in {sigma_path.name}), the estimate covers "
        f"{_covers(silhouette(mesh.astype(np.float32), extent=EXTENT)) * unit:.0f} cm², what was observed "
        f"{_covers(_observed(source.observation.points)) * unit:.0f} cm²"
    )


def _numbered(path: Path, i: int) -> Path:
    """Return the path of shape i: the first one's is `path`."""
    return path if i == 0 else path.with_name(f"{path.name.split('.')[0]}.{i + 1}.{path.name.split('.', 1)[1]}")


def _observed(points: Float[np.ndarray, "points 3"]) -> Bool[np.ndarray, "x y"]:
    """Return the mask of the pixels of the square -EXTENT..EXTENT that observed points cover."""
    return covered(points[:, :2], resolution=resolution_for(points[:, :2], EXTENT), extent=EXTENT)


def _covers(pixels: Bool[np.ndarray, "x y"]) -> float:
    """Return the area of a mask over the square -EXTENT..EXTENT, as a share of the flat cloth's area."""
    return float(pixels.mean() * (2 * EXTENT) ** 2 / CLOTH_LENGTH**2)
