"""The inputs of commands: settings, and states and goals that are read from files and observed as by a camera."""

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple

import click
import numpy as np
from jaxtyping import Bool, Float

from clothkit.app.settings import AppConfig
from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE, Topology
from clothkit.estimation import alarms
from clothkit.estimation.alarms import Alarms
from clothkit.goals.variants import Variant
from clothkit.manipulation.candidates import CandidateConfig
from clothkit.models import store
from clothkit.observation.cloud import Observation
from clothkit.observation.files import State, read
from clothkit.observation.observe import observe
from clothkit.observation.plane import Plane, plane_of
from clothkit.observation.pose import Pose
from clothkit.observation.settings import CloudConfig, Triple
from clothkit.observation.side import Stated
from clothkit.observation.silhouettes import points_of
from clothkit.observation.states import MeshState, PointCloud, SilhouetteState, VoxelState
from clothkit.params import load_params
from clothkit.planning import trust
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.objective import Weights
from clothkit.planning.settings import PlanConfig
from clothkit.runtime.cache import ensure_jax_cache
from clothkit.runtime.errors import InputError, system_error
from clothkit.simulation.cloths import topology_of
from clothkit.simulation.settings import SimulationConfig

PARAMS = Path("params.yaml")
_WEIGHTS = Weights(alpha=1.0, beta=5.0, gamma=1.25)

SIDES, THICKEST = (0.01, 10.0), 0.1
"""Least and largest longer side, and largest thickness of a cloth [m]: beyond them, the number is in another unit."""

LARGEST_RATIO = 4.0
"""Largest accepted ratio of a cloth's sides; nets know less (`simulate.variation.ratio`)."""

Kind = Literal["mesh", "voxels", "points"]
Usage = Literal["as it is", "estimated"]


class Settings(NamedTuple):
    """The settings that commands use."""

    app: AppConfig
    plan: PlanConfig
    weights: Weights
    grasping: CandidateConfig
    simulation: SimulationConfig
    members: tuple[int, ...]
    """The members of the ensemble of forward models."""
    data: Path = Path("data")
    """The folder of the nets."""
    alarms: Alarms | None = None
    """From which signs on an observation is unknown to the net that estimates meshes; None: not set."""
    trust: ErrorMap | None = None
    """How far the expectations of system main came true; None: not known."""


def load_settings(data: Path, *, scale: str | None = None) -> Settings:
    """Read params.yaml in the current directory, at its selected scale or another; without such a file return the
    defaults.

    Voxels are those that the net under `data` that estimates meshes takes, if there is one, and alarms are its own; how
    far plans can be trusted is what is known of the nets there.
    Raises InputError if a file is invalid.
    """
    settings, calibrated = _settings(scale)._replace(data=data), data / trust.PLACE
    if calibrated.exists():
        settings = settings._replace(trust=trust.load(calibrated))
    vtm, set_alarms = data / "nets/vtm", data / "nets/alarms.npz"
    if not vtm.exists():
        return settings
    net = store.configuration(vtm, "vtm")
    cloud = dataclasses.replace(settings.app.cloud, viewport=net.viewport)
    known = alarms.load(set_alarms, units=net.hidden) if set_alarms.exists() else None
    return settings._replace(app=dataclasses.replace(settings.app, cloud=cloud), alarms=known)


def _settings(scale: str | None) -> Settings:
    # lexists, because a broken or circular link must be reported and not replaced by the defaults.
    if not os.path.lexists(PARAMS):
        return Settings(AppConfig(), PlanConfig(), _WEIGHTS, CandidateConfig(), SimulationConfig(), (0, 1))
    params = load_params(PARAMS)
    if scale is not None:
        if scale not in params.scales:
            raise InputError(f"{PARAMS}: scales: has no {scale}, with whose settings the prebuilt nets are used")
        params = params.model_copy(update={"scale": scale})
    simulate = params.stages.simulate
    weights = Weights(params.alpha, params.beta, params.gamma)
    return Settings(
        params.app, params.stages.plan, weights, simulate.candidates, simulate.simulation, params.ensemble.members
    )


def keep_compiled_programs() -> None:
    """Let JAX cache compiled programs on disk for the next call: compiling a search takes longer than running it."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    ensure_jax_cache(home / "clothkit/compiled")


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


@dataclasses.dataclass(frozen=True)
class Input:
    """A state or a goal: the file's name, its content, and the observation of it."""

    file: str
    state: State
    observation: Observation
    cloth: Float[np.ndarray, "3"]
    """The cloth's sides along u and along v and its thickness [normalised]."""
    variant: Variant | None = None
    """Of a named goal, whose name is in the place of the file's; None: a file."""

    @property
    def kind(self) -> Kind:
        """The kind of the file's content."""
        if isinstance(self.state, MeshState):
            return "mesh"
        return "voxels" if isinstance(self.state, VoxelState) else "points"

    @property
    def notices(self) -> tuple[str, ...]:
        """Sentences on how the file was read, and on the parts of the cloth that were not observed."""
        return (*self.state.notices, *self.observation.notices)

    @property
    def pose(self) -> Pose:
        """The pose of the cloth."""
        return self.observation.pose


def read_input(file: str, options: ObservationOptions, *, mask: str | None = None) -> Input:
    """Read a file and observe its cloth. Prints the notices on stderr.

    `mask` names an NPY file [points] that marks the points of the cloth in a cloud. Raises InputError.
    """
    state = read_state(file, options)
    tell(state.notices)
    if mask is not None:
        state = with_mask(state, mask, file)
    found = observed(state, options, name=file)
    tell((*found.state.notices[len(state.notices) :], *found.observation.notices))
    return found


def tell(notices: tuple[str, ...]) -> None:
    """Print notices on stderr."""
    for notice in notices:
        click.echo(f"notice: {notice}", err=True)


def read_state(file: str | Path, options: ObservationOptions) -> State:
    """Read a file. Raises InputError."""
    return read(
        file, cloth_side=options.side, y_up=options.y_up, as_points=options.as_points, topology=options.topology
    )


def with_mask(state: State, mask: str | Path, name: str) -> State:
    """Return a point cloud, which messages call `name`, with the mask of its cloth, an NPY file. Raises InputError."""
    if not isinstance(state, PointCloud):
        raise InputError(f"{mask}: is a mask for points, but {name} holds none")
    return dataclasses.replace(state, cloth=_read_mask(Path(mask), len(state.points)))


def observed(state: State, options: ObservationOptions, *, name: str) -> Input:
    """Observe the cloth of a state, which messages call `name`. Raises InputError."""
    cloud, table, stated = options.cloud, options.table, options.stated
    if isinstance(state, SilhouetteState):
        area, surface = options.sides[0] * options.sides[1], cloud.surface
        state = points_of(
            state, area=area, thickness=options.thickness, surface=surface, table=options.table, name=name
        )
    if isinstance(state, PointCloud) and state.table is not None:
        # The options describe a camera's cloud; these points are of a surface whose table is known.
        cloud, table, stated = dataclasses.replace(cloud, box=None, table_colour=None), None, Stated()
    observation = observe(state, cloth_side=options.side, settings=cloud, table=table, stated=stated, name=name)
    return Input(name, state, observation, options.cloth)


def _read_mask(path: Path, count: int) -> Bool[np.ndarray, " points"]:
    try:
        with path.open("rb") as file:
            mask: Any = np.load(file, allow_pickle=False)
    except OSError as error:
        if error.errno is not None:
            raise system_error(error, path, expected="a mask as NPY") from error
        raise InputError(f"{path}: can't be read as NPY, expected a mask") from error
    except Exception as error:  # numpy's readers raise what they like
        raise InputError(f"{path}: can't be read as NPY, expected a mask") from error
    if not isinstance(mask, np.ndarray) or mask.shape != (count,) or not np.isin(mask, (0, 1)).all():
        raise InputError(f"{path}: is no mask of {count} points, expected an array [{count}] of 0 and 1")
    return mask.astype(bool)


_CLOTH_OPTIONS = (
    click.option(
        "--side",
        type=float,
        metavar="METRES",
        help="Side of the flat cloth, if it is a square. [default: a given plan's, else app.side]",
    ),
    click.option("--sides", type=float, nargs=2, metavar="METRES METRES", help="Both sides, if it is no square."),
    click.option(
        "--thickness",
        type=float,
        metavar="METRES",
        help="Distance of the middles of two layers that touch: half the height of the cloth, folded once and pressed "
        "flat. [default: a given plan's, else app.thickness]",
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
                "Without it the plane is looked for among the points that are not the cloth's.",
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
    cloud = app.cloud
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
        _sides(app, side, sides),
        _thickness(app, thickness),
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
