"""Paths of the hands in metres over time (section 4.2.2), the box that they reach, and the symmetries of a cloth."""

import dataclasses
from typing import Annotated

import jax.numpy as jnp
import numpy as np
from annotated_types import Ge, Gt
from jaxtyping import Float

from clothkit.cloth.mesh import error
from clothkit.cloth.topology import PAPERS_CLOTH
from clothkit.manipulation.geometry import arc, release_points, to_cartesian
from clothkit.manipulation.turns import planar, turn_mesh
from clothkit.manipulation.vector import displacement, grasp_points, is_null, is_single
from clothkit.observation.pose import Pose
from clothkit.runtime.config import config
from clothkit.simulation.settings import SimulationConfig

_SIMULATED = SimulationConfig()


@config
class MotionConfig:
    """Settings of the hands' motion; the defaults are those of the simulation."""

    hand_speed: Annotated[float, Gt(0)] = _SIMULATED.hand_speed
    """Mean speed along the longer arc [m/s]."""
    shortest_move: Annotated[float, Gt(0)] = _SIMULATED.shortest_move
    """Shortest duration of a move [s]."""
    highest_lift: Annotated[float, Gt(0)] = _SIMULATED.highest_lift
    """Normalised: hands end min(highest_lift, k / 2) above the grasp point, where k is the distance that they move."""
    waypoints: Annotated[int, Ge(2)] = 21
    """Number of waypoints per hand, including both ends."""


@config
class ReachConfig:
    """The box that a robot's hands can reach [m], in the table's frame."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class HandPaths:
    """The positions of the hands over time during one manipulation; without hands for a null manipulation."""

    times: Float[np.ndarray, " waypoints"]
    """Seconds from the grasp."""
    points: Float[np.ndarray, "hands waypoints 3"]
    """Metres, in the table's frame; in the order of the manipulation's grasp points."""


def hand_paths(
    manipulation: Float[np.ndarray, "6"],
    mesh: Float[np.ndarray, "u v 3"],
    pose: Pose,
    settings: MotionConfig = MotionConfig(),  # noqa: B008
) -> HandPaths:
    """The hands' paths for a manipulation of a cloth [m]: arcs, slow at both ends.

    `mesh` is the cloth as estimated or predicted before the manipulation, normalised and centred. `pose` is its pose at
    that time: for a later step of a plan, the observed pose after `Pose.moved` by the predicted centre shifts.
    """
    grasps = np.stack([np.asarray(to_cartesian(mesh, uv), float) for uv in grasp_points(manipulation)])
    return paths_from(grasps, manipulation, pose, settings)


def paths_from(
    grasps: Float[np.ndarray, "2 3"],
    manipulation: Float[np.ndarray, "6"],
    pose: Pose,
    settings: MotionConfig = MotionConfig(),  # noqa: B008
) -> HandPaths:
    """The hands' paths for a manipulation whose grasp points lie at `grasps` [normalised, centred]."""
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


def symmetries(
    mesh: Float[np.ndarray, "u v 3"], *, cloth: Float[np.ndarray, "3"] = PAPERS_CLOTH, within: float = 0.02
) -> list[Float[np.ndarray, "2 2"]]:
    """The matrices of the turns by right angles and the mirrorings under which a cloth looks the same; identity first.

    They refer to the cloth's own axes, so a flat cloth has all eight in any direction. A turned cloth looks the same if
    the error of one of its equivalents against the cloth is at most `within` [cloth lengths]; those with other sides
    than `cloth` has do not count.
    """
    along = (mesh[-1] - mesh[0]).mean(0)
    lean = float(np.arctan2(along[1], along[0]))
    back, forth = (np.asarray(planar(jnp.float32(a), jnp.bool_(False)), float) for a in (-lean, lean))
    found = [np.eye(2)]
    for mirrored in (False, True):
        for quarter in range(4):
            matrix = forth @ np.asarray(planar(jnp.float32(quarter * np.pi / 2), jnp.bool_(mirrored)), float) @ back
            turned = turn_mesh(jnp.asarray(mesh), jnp.asarray(matrix, jnp.float32))
            if (mirrored or quarter) and float(error(turned, mesh, cloth=cloth)) <= within:
                found.append(matrix)
    return found
