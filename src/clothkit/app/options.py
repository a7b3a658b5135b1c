"""How commands are told to observe a cloth: the options of the command line, with settings where they are not given."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import click
import numpy as np
from jaxtyping import Float

from clothkit.app.settings import AppConfig
from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE, Topology
from clothkit.observation.plane import Plane, plane_of
from clothkit.observation.settings import CloudConfig, Triple
from clothkit.observation.side import Stated
from clothkit.runtime.errors import InputError
from clothkit.simulation.cloths import topology_of

SIDES, THICKEST = (0.01, 10.0), 0.1
"""Least and largest longer side, and largest thickness of a cloth [m]: beyond them, the number is in another unit."""

WITHIN = 100.0
"""Largest distance from a frame's origin, along each axis [m]: beyond it, a number is a mistake, as in millimetres."""

LARGEST_RATIO = 4.0
"""Largest accepted ratio of a cloth's sides; nets know less (`simulate.variation.ratio`)."""


class ObservationOptions(NamedTuple):
    """How files are read and observed."""

    sides: tuple[float, float]
    """Sides of the flat cloth, the longer one first [m]."""
    thickness: float
    """Distance of the middles of two layers that touch [m]."""
    cloud: CloudConfig
    table: Plane | None
    stated: Stated = Stated()
    """Up direction and viewpoint, if they are given, in the clouds' frame."""
    y_up: bool = False
    """Whether OBJ and PLY meshes have y up."""
    as_points: bool = False
    """Whether the vertices of a mesh that is no 32 x 32 grid are used as a measured point cloud."""

    @property
    def side(self) -> float:
        """The longer side of the flat cloth [m]."""
        return self.sides[0]

    @property
    def scale(self) -> float:
        """Metres per normalised unit."""
        return self.side / CLOTH_LENGTH

    @property
    def cloth(self) -> Float[np.ndarray, "3"]:
        """The cloth's sides along u, the longer one, and along v, and its thickness [normalised]."""
        return np.array([*self.sides, self.thickness], np.float32) * np.float32(CLOTH_LENGTH / self.side)

    @property
    def topology(self) -> Topology:
        """The grid of a mesh of this cloth."""
        return topology_of(SQUARE.shape[0], (float(self.cloth[0]), float(self.cloth[1])))


_CLOTH_OPTIONS = (
    click.option(
        "--side",
        type=float,
        metavar="METRES",
        help="Side of the flat cloth, if it is a square. [default: a given plan's, else app.side, 0.4]",
    ),
    click.option(
        "--sides", type=float, nargs=2, metavar="METRES METRES", help="Both sides in any order, if it is no square."
    ),
    click.option(
        "--thickness",
        type=float,
        metavar="METRES",
        help="Distance of the middles of two layers that touch: half the height of the cloth, folded once and pressed "
        "flat. [default: a given plan's, else app.thickness, 0.002]",
    ),
)


def with_cloth_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator that adds the options of the cloth alone: its sides and its thickness."""
    for option in reversed(_CLOTH_OPTIONS):
        command = option(command)
    return command


def with_observation_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator that adds the options for reading and observing files; `observation_options` converts their values."""
    for option in reversed(
        (
            *_CLOTH_OPTIONS,
            click.option(
                "--mask", metavar="FILE", help="NPY [n] of 0 and 1: which points of the state's cloud are the cloth's."
            ),
            click.option(
                "--as-points",
                is_flag=True,
                help="The vertices of a mesh that is no grid of 32 x 32 are what a camera measured; its faces are left "
                "out.",
            ),
            click.option(
                "--table",
                type=float,
                nargs=4,
                metavar="A B C D",
                help="The table's plane a x + b y + c z = d in metres and in the cloud's frame, (a, b, c) pointing up. "
                "It does not tell which points are the cloth's. Without it the plane is looked for among those that "
                "are not.",
            ),
            click.option(
                "--up",
                type=float,
                nargs=3,
                metavar="X Y Z",
                help="Which way is up in the clouds' frame, of any length. Without it the table's normal, the "
                "viewpoint or the cloth tells.",
            ),
            click.option(
                "--viewpoint",
                type=float,
                nargs=3,
                metavar="X Y Z",
                help="Where the camera is, metres in the clouds' frame. [default: where the cloud says; else the "
                "origin, if the cloth lies on that side of its table]",
            ),
            click.option(
                "--y-up",
                is_flag=True,
                default=None,
                help="OBJ and PLY meshes have y up, and not z; so have clouds, unless --up or --table tells else.",
            ),
            click.option(
                "--table-colour",
                type=click.IntRange(0, 255),
                nargs=6,
                metavar="R G B R G B",
                help="Least and greatest red, green, blue (0 to 255) of the table: all else is cloth.",
            ),
            click.option(
                "--box",
                type=float,
                nargs=6,
                metavar="X Y Z X Y Z",
                help="Low and high corner of what is looked at, metres in the cloud's frame.",
            ),
        )
    ):
        command = option(command)
    return command


def observation_options(
    app: AppConfig,
    *,
    side: float | None,
    sides: tuple[float, float] | None = None,
    thickness: float | None = None,
    table: tuple[float, ...] | None = None,
    table_colour: tuple[int, ...] | None = None,
    box: tuple[float, ...] | None = None,
    up: Triple | None = None,
    viewpoint: Triple | None = None,
    y_up: bool | None = None,
    as_points: bool = False,
) -> ObservationOptions:
    """How files are read and observed, by option values and else by settings. Raises InputError for invalid values."""
    longer, shorter = _sides(app, side, sides)
    layer = _thickness(app, thickness)
    # A camera sees a cloth's surface, half a layer above the vertices, and as high as the voxels are that nets take.
    cloud = dataclasses.replace(
        app.cloud,
        surface=app.cloud.surface or layer / 2,
        highest=max(app.cloud.highest, app.cloud.viewport.height * longer / CLOTH_LENGTH),
    )
    if table_colour:
        if np.shape(table_colour) != (6,):
            raise InputError("--table-colour: expected six numbers, the low corner of the colours and the high one")
        r, g, b, most_r, most_g, most_b = table_colour
        least, most = (r, g, b), (most_r, most_g, most_b)
        ordered("--table-colour", least, most)
        cloud = dataclasses.replace(cloud, table_colour=(least, most))
    if box:
        cloud = dataclasses.replace(cloud, box=corners("--box", box))
    plane, camera, turned = table or app.table, viewpoint or app.viewpoint, app.y_up if y_up is None else y_up
    # The normal of a table from an option points up, so `app.up` must not override it.
    up = up or (None if table else app.up)
    if turned and up is None and plane is None and camera is None:
        up = (0.0, 1.0, 0.0)
    for name, values in (("up", up), ("viewpoint", camera)):
        if values is not None and not np.isfinite(values).all():
            raise InputError(f"--{name}: expected three finite numbers, found {' '.join(f'{v:g}' for v in values)}")
    if up is not None and not any(up):
        raise InputError("--up: expected a direction, found 0 0 0")
    return ObservationOptions(
        (longer, shorter),
        layer,
        cloud,
        plane_of(plane) if plane else None,
        Stated(up, camera),
        turned,
        as_points,
    )


def _sides(app: AppConfig, side: float | None, sides: tuple[float, float] | None) -> tuple[float, float]:
    """The sides of the flat cloth, the longer one first, by option values and else by settings."""
    if side is not None and sides is not None:
        raise InputError("--side, --sides: expected one of them, found both")
    found = sides or ((side, side) if side is not None else (app.side, app.shorter or app.side))
    if not (np.isfinite(found).all() and min(found) > 0):
        given = f"--sides: {found[0]:g} x {found[1]:g}" if side is None else f"--side: {side:g}"
        raise InputError(f"{given}, expected metres above 0")
    longer, shorter = max(found), min(found)
    if not SIDES[0] <= longer <= SIDES[1]:
        given = f"--sides: {longer:g} x {shorter:g}" if side is None else f"--side: {side:g}"
        raise InputError(f"{given}, expected metres, from {SIDES[0]:g} to {SIDES[1]:g}")
    if longer > LARGEST_RATIO * shorter:
        raise InputError(f"--sides: {longer:g} x {shorter:g}, expected at most {LARGEST_RATIO:g} times the shorter one")
    return longer, shorter


def _thickness(app: AppConfig, thickness: float | None) -> float:
    found = app.thickness if thickness is None else thickness
    if not (np.isfinite(found) and 0 < found <= THICKEST):
        raise InputError(f"--thickness: {found:g}, expected metres above 0, at most {THICKEST:g}")
    return found


def corners(name: str, box: tuple[float, ...]) -> tuple[Triple, Triple]:
    """Return the low and the high corner of a box from six numbers. Raises InputError."""
    if not np.isfinite(box).all():
        raise InputError(f"{name}: expected six finite numbers, found {' '.join(f'{value:g}' for value in box)}")
    x, y, z, to_x, to_y, to_z = box
    ordered(name, (x, y, z), (to_x, to_y, to_z))
    return (x, y, z), (to_x, to_y, to_z)


def ordered(name: str, low: tuple[int, ...] | tuple[float, ...], high: tuple[int, ...] | tuple[float, ...]) -> None:
    """Check that each number of a low corner is at most that of a high one. Raises InputError."""
    if any(a > b for a, b in zip(low, high, strict=True)):
        raise InputError(f"{name}: {low} is not below {high}, expected the low corner first")
