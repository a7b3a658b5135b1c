"""`clothkit estimate`: estimate a mesh, with standard deviations, from voxels or a point cloud."""

from pathlib import Path
from typing import Any

import click
import numpy as np
from jaxtyping import Bool, Float

from clothkit.app.agreement import compare_estimate
from clothkit.app.inputs import (
    keep_compiled_programs,
    load_settings,
    observation_options,
    read_input,
    with_observation_options,
)
from clothkit.app.output import check_target, part, write_arrays, write_mesh
from clothkit.app.planner import estimate_mesh, load_vtm
from clothkit.cloth.silhouette import silhouette
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.dataset.export import FORMATS
from clothkit.observation.coverage import EXTENT, covered, resolution_for


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
    "--data", type=click.Path(path_type=Path), default=Path("data"), show_default=True, help="Where nets/vtm is."
)
@with_observation_options
def command(file: str, *, out: Path, sigma: Path | None, data: Path, mask: str | None, **values: Any) -> None:
    """Estimate the mesh of the cloth in FILE: voxels, a point cloud, or a mesh as a camera above would see it.

    The net gives a mean and a standard deviation for each coordinate; the mesh is what is plausible within them.
    All are in the table's frame, z up (y up in GLB), the table at 0.

    \b
    clothkit estimate cloud.ply --table 0 0 -1 -0.8 --out mesh.obj
    """
    settings = load_settings(data)
    options = observation_options(settings.app, **values)
    check_target(out, FORMATS)
    sigma_path = sigma or out.with_suffix(".sigma.npz")
    check_target(sigma_path, ("npz",))
    keep_compiled_programs()
    with part("observe"):
        source = read_input(file, options, mask=mask)
    with part("estimate"):
        found = estimate_mesh(load_vtm(data), source, settings)
    mesh, mean = (np.asarray(part[0], float) for part in (found.mesh, found.probabilistic.mean))
    std = np.asarray(found.probabilistic.std[0], float)
    place, scale = source.pose.normalised_to_table, source.pose.scale
    write_mesh(out, place(mesh))
    arrays = {"mesh": place(mesh), "mean": place(mean), "sigma": std * scale}
    write_arrays(sigma_path, {name: array.astype(np.float32) for name, array in arrays.items()})
    agreement = compare_estimate(source, mesh, settings)
    unit = (CLOTH_LENGTH * scale) ** 2 * 1e4
    click.echo(
        f"{out}: sigma {1000 * scale * std.mean():.1f} mm on average (in {sigma_path.name}), the estimate covers "
        f"{_covers(silhouette(mesh.astype(np.float32), extent=EXTENT)) * unit:.0f} cm², what was observed "
        f"{_covers(_observed(source.observation.points)) * unit:.0f} cm²"
    )
    click.echo(f"{'' if agreement.explains else 'warning: '}{agreement.sentence}")


def _observed(points: Float[np.ndarray, "points 3"]) -> Bool[np.ndarray, "x y"]:
    """Return the mask of the pixels of the square -EXTENT..EXTENT that observed points cover."""
    return covered(points[:, :2], resolution=resolution_for(points[:, :2], EXTENT), extent=EXTENT)


def _covers(pixels: Bool[np.ndarray, "x y"]) -> float:
    """Return the area of a mask over the square -EXTENT..EXTENT, as a share of the flat cloth's area."""
    return float(pixels.mean() * (2 * EXTENT) ** 2 / CLOTH_LENGTH**2)
