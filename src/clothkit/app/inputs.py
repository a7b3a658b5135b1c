"""The inputs of commands: settings, and states and goals that are read from files and observed as by a camera."""

import dataclasses
import os
from pathlib import Path
from typing import Any, Literal, NamedTuple

import click
import numpy as np
from jaxtyping import Bool, Float

from clothkit.app.options import WITHIN, ObservationOptions
from clothkit.app.settings import AppConfig
from clothkit.cloth.voxels import RESOLUTION
from clothkit.estimation import alarms
from clothkit.estimation.alarms import Alarms
from clothkit.goals.variants import Variant
from clothkit.manipulation.candidates import CandidateConfig
from clothkit.models import store
from clothkit.observation.cloud import Observation
from clothkit.observation.files import State, read
from clothkit.observation.observe import observe
from clothkit.observation.pose import Pose
from clothkit.observation.segment import MAX_COVERED
from clothkit.observation.side import Stated
from clothkit.observation.silhouettes import points_of
from clothkit.observation.states import MeshState, PointCloud, SilhouetteState, VoxelState
from clothkit.params import load_params
from clothkit.planning import trust
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.objective import Weights
from clothkit.planning.settings import PlanConfig
from clothkit.planning.systems import System
from clothkit.runtime.cache import ensure_jax_cache
from clothkit.runtime.errors import InputError, system_error
from clothkit.simulation.settings import SimulationConfig

PARAMS = Path("params.yaml")
_WEIGHTS = Weights(alpha=1.0, beta=5.0, gamma=1.25)

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

    def trust_in(self, system: System) -> ErrorMap | None:
        """Return how far a system's expectations came true; None: not known, as of all systems but main."""
        return self.trust if system.name == "main" else None


def load_settings(data: Path, *, scale: str | None = None) -> Settings:
    """Read params.yaml in the current directory, at its selected scale or another; without such a file return the
    defaults.

    Voxels are those that the net under `data` that estimates meshes takes, if there is one, and alarms are its own; how
    far plans can be trusted is what is known of the nets there.
    Raises InputError if a file is invalid.
    """
    settings, calibrated = settings_of_params(scale)._replace(data=data), data / trust.PLACE
    if calibrated.exists():
        settings = settings._replace(trust=trust.load(calibrated))
    vtm, set_alarms = data / "nets/vtm", data / "nets/alarms.npz"
    if not vtm.exists():
        return settings
    net = store.configuration(vtm, "vtm")
    cloud = dataclasses.replace(settings.app.cloud, viewport=net.viewport)
    known = alarms.load(set_alarms, units=net.hidden) if set_alarms.exists() else None
    return settings._replace(app=dataclasses.replace(settings.app, cloud=cloud), alarms=known)


def settings_of_params(scale: str | None = None) -> Settings:
    """Read params.yaml as `load_settings` does, without what is known of any nets. Raises InputError."""
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
        area = options.sides[0] * options.sides[1]
        state = points_of(state, area=area, thickness=options.thickness, table=options.table, name=name)
    if isinstance(state, PointCloud) and state.table is not None:
        # The options describe a camera's cloud; these points are where vertices are, and their table is known.
        cloud = dataclasses.replace(cloud, box=None, table_colour=None, surface=0.0)
        table, stated = None, Stated()
    observation = observe(state, cloth_side=options.side, settings=cloud, table=table, stated=stated, name=name)
    if isinstance(state, PointCloud):
        _check_area(observation, options.sides, name)
    farthest = float(np.abs(observation.pose.normalised_to_camera(np.zeros((1, 3)))).max())
    if farthest > WITHIN - 2 * options.side:
        raise InputError(
            f"{name}: the cloth is {farthest:.0f} m away from its frame's origin, of which a plan stays within "
            f"{WITHIN:.0f} m; expected metres in a frame near the cloth"
        )
    return Input(name, state, observation, options.cloth)


def _check_area(observation: Observation, sides: tuple[float, float], name: str) -> None:
    """Raises InputError when a cloud covers more than a cloth with these sides [m] can."""
    cell = 2 / RESOLUTION[0] * observation.pose.scale
    area = float(observation.voxels.any(-1).sum()) * cell**2
    # Columns at the border count in full, though the cloth covers only a part of them.
    if area > MAX_COVERED * (sides[0] + 2 * cell) * (sides[1] + 2 * cell):
        raise InputError(
            f"{name}: what should be the cloth covers {area:.2g} m², more than one of {sides[0]:g} x {sides[1]:g} m "
            "can; check its sides, and which points are the cloth's"
        )


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
