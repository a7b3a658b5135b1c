"""A plan in metres: where the hands are when, and turned or mirrored so that a robot reaches it all (section 4.2.2)."""

import dataclasses
from collections.abc import Sequence
from typing import Annotated

import jax.numpy as jnp
import numpy as np
from annotated_types import Ge, Gt
from jaxtyping import Float

from clothkit.cloth.mesh import error
from clothkit.config import config
from clothkit.errors import InputError
from clothkit.manipulation.geometry import arc, release_points, to_cartesian
from clothkit.manipulation.turns import planar, turn_mesh
from clothkit.manipulation.vector import displacement, grasp_points, is_null, is_single
from clothkit.observation.pose import Pose
from clothkit.simulation.settings import SimulationConfig

_SIMULATED = SimulationConfig()


@config
class MotionConfig:
    """How the hands move; as they do in simulation."""

    hand_speed: Annotated[float, Gt(0)] = _SIMULATED.hand_speed
    """Mean along the longer arc [m/s]."""
    shortest_move: Annotated[float, Gt(0)] = _SIMULATED.shortest_move
    """Seconds."""
    highest_lift: Annotated[float, Gt(0)] = _SIMULATED.highest_lift
    """Normalised: hands end at min(highest_lift, k / 2) above where they grasped."""
    waypoints: Annotated[int, Ge(2)] = 21
    """For each hand, both ends among them."""


@config
class ReachConfig:
    """The box that a robot's hands reach [m], in the table's frame."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class HandPaths:
    """Where the hands are when, during one manipulation. No hands: the null manipulation."""

    times: Float[np.ndarray, " waypoints"]
    """Seconds from the grasp."""
    points: Float[np.ndarray, "hands waypoints 3"]
    """Metres, in the table's frame; in the order of the manipulation's grasp points."""


@dataclasses.dataclass(frozen=True)
class Turned:
    """Paths that were turned or mirrored, and how."""

    paths: tuple[HandPaths, ...]
    matrix: Float[np.ndarray, "2 2"]
    """Of the plane, as manipulation.turns has it: the goal that is now reached is the goal turned by it."""


def hand_paths(
    manipulation: Float[np.ndarray, "6"],
    mesh: Float[np.ndarray, "u v 3"],
    pose: Pose,
    settings: MotionConfig = MotionConfig(),  # noqa: B008
) -> HandPaths:
    """The arcs of a manipulation of a cloth, slow at both ends, in metres.

    `mesh` is the cloth as it is estimated or predicted before the manipulation, normalised and centred, `pose` where it
    is then: for a later step of a plan, `pose.moved` by the predicted shifts of its centre.
    """
    grasps = np.stack([np.asarray(to_cartesian(mesh, uv), float) for uv in grasp_points(manipulation)])
    return paths_from(grasps, manipulation, pose, settings)


def paths_from(
    grasps: Float[np.ndarray, "2 3"],
    manipulation: Float[np.ndarray, "6"],
    pose: Pose,
    settings: MotionConfig = MotionConfig(),  # noqa: B008
) -> HandPaths:
    """The same for a manipulation whose grasp points are known to lie at `grasps` [normalised, centred]."""
    if bool(is_null(manipulation)):
        return HandPaths(np.zeros(settings.waypoints), np.zeros((0, settings.waypoints, 3)))
    hands = 1 if bool(is_single(manipulation)) else 2
    releases = release_points(grasps[:, :2], np.asarray(displacement(manipulation), float)).points
    path = arc(grasps[:hands], np.asarray(releases)[:hands], height_limit=settings.highest_lift)
    share = np.linspace(0, 1, settings.waypoints)
    points = np.stack([path.at(part) for part in share**2 * (3 - 2 * share)], axis=1)
    longest = float((path.radius * path.angle).max()) * pose.scale
    seconds = max(longest / settings.hand_speed, settings.shortest_move)
    return HandPaths(share * seconds, pose.normalised_to_table(points))


def symmetries(mesh: Float[np.ndarray, "u v 3"], *, within: float = 0.02) -> list[Float[np.ndarray, "2 2"]]:
    """The turns by right angles, and mirrorings, under which a cloth looks as before; the identity first.

    All eight for a flat cloth, however it lies: they are about its own axes. A turned cloth looks as before if an
    equivalent of it is within so many cloth lengths of the cloth.
    """
    along = (mesh[-1] - mesh[0]).mean(0)
    lean = float(np.arctan2(along[1], along[0]))
    back, forth = (np.asarray(planar(jnp.float32(a), jnp.bool_(False)), float) for a in (-lean, lean))
    found = [np.eye(2)]
    for mirrored in (False, True):
        for quarter in range(4):
            matrix = forth @ np.asarray(planar(jnp.float32(quarter * np.pi / 2), jnp.bool_(mirrored)), float) @ back
            turned = turn_mesh(jnp.asarray(mesh), jnp.asarray(matrix, jnp.float32))
            if (mirrored or quarter) and float(error(turned, mesh)) <= within:
                found.append(matrix)
    return found


def turned(paths: HandPaths, matrix: Float[np.ndarray, "2 2"], *, about: Float[np.ndarray, "2"]) -> HandPaths:
    """The paths turned or mirrored in the plane about a point [m] of the table."""
    xy = about + (paths.points[..., :2] - about) @ matrix.T
    return HandPaths(paths.times, np.concatenate([xy, paths.points[..., 2:]], axis=-1))


def beyond(paths: Sequence[HandPaths], reach: ReachConfig) -> float:
    """How far the farthest waypoint is outside the box along one axis [m]; 0 if all are in it."""
    points = np.concatenate([path.points.reshape(-1, 3) for path in paths] or [np.zeros((0, 3))])
    return float(np.maximum(reach.low - points, points - reach.high).max(initial=0.0))


def within_reach(
    paths: Sequence[HandPaths], reach: ReachConfig, mesh: Float[np.ndarray, "u v 3"], pose: Pose
) -> Turned:
    """The first of the plan's turned or mirrored forms whose waypoints all lie in the box, the plan itself first.

    `mesh` [normalised, centred] and `pose` are the cloth's before the plan: it may be turned only so that this cloth
    looks as before. All steps turn about its centre. Raises InputError when no form is in reach.
    """
    nearest = np.inf
    for matrix in symmetries(mesh):
        moved = tuple(turned(path, matrix, about=pose.centre) for path in paths)
        outside = beyond(moved, reach)
        if outside == 0:
            return Turned(moved, matrix)
        nearest = min(nearest, outside)
    raise InputError(
        f"plan: out of reach, however it is turned a waypoint is at least {nearest:.3g} m outside the box "
        f"{reach.low}..{reach.high}"
    )
