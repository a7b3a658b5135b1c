"""The scene of a session: cloths, paths, points and captions as plain arrays, independent of how they are drawn."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from clothkit.app.describe import heights
from clothkit.app.viewer import colours
from clothkit.app.viewer.colours import Colour, Mode, Scale
from clothkit.app.viewer.session import Mesh, Session, State, disagreement, error_of, is_mesh, places
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.cloth.voxels import HEIGHT, RESOLUTION
from clothkit.manipulation.geometry import arc, release_points, to_cartesian
from clothkit.manipulation.vector import displacement, grasp_points, is_null, is_single

SPACING = 1.9
"""Distance between cloths that are side by side [normalised]."""
WAYPOINTS = 33
LIFT = 0.004
"""Height of points and paths above the cloth [normalised], which would otherwise hide half of each."""
_BEFORE = np.array([0, -0.86, 0], np.float32)  # from a cloth's middle to its caption
_SURELY = 0.5  # probability from which a voxel counts as cloth

Points = Float[np.ndarray, "points 3"]
Colours = Float[np.ndarray, "points 3"]
Ghost = Literal["over the cloth", "beside it", "hidden"]


class Shown(NamedTuple):
    """A state of the cloth that can be shown, with its uncertainties, grasp points and manipulation."""

    name: str
    state: State
    sigma: Mesh | None = None
    apart: Float[np.ndarray, "u v"] | None = None
    """Distance between the nets' predictions of each vertex, in the mean over all pairs of nets [normalised]."""
    candidates: Float[np.ndarray, "points 2"] | None = None
    manipulation: Float[np.ndarray, "6"] | None = None
    """The manipulation that the plan has for this state."""
    row: int = 0
    """Row in the side-by-side view: the first holds the state and its estimate, then there is one row per net."""
    column: int = 0


class Cloth(NamedTuple):
    """A mesh, with the colours of its two sides."""

    mesh: Mesh
    front: Float[np.ndarray, "u v 3"]
    back: Float[np.ndarray, "u v 3"]
    opacity: float = 1.0


class Path(NamedTuple):
    """The path of a hand from its grasp point to its release point."""

    points: Points
    colour: tuple[float, float, float]


class Dots(NamedTuple):
    """Points, drawn as balls of one size or, for voxels, as boxes."""

    points: Points
    colours: Colours
    size: float
    cubes: bool = False


class Caption(NamedTuple):
    """Text at a position."""

    text: str
    place: Float[np.ndarray, "3"]


class Scene(NamedTuple):
    """Everything to draw [normalised]; z is up, the table is z = 0."""

    cloths: tuple[Cloth, ...] = ()
    paths: tuple[Path, ...] = ()
    dots: tuple[Dots, ...] = ()
    captions: tuple[Caption, ...] = ()
    middles: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    """xy of the middle of each cloth and of the goal."""


class View(NamedTuple):
    """The choices of the person at the page."""

    shown: str = "state"
    mode: Mode = "side"
    ghost: Ghost = "over the cloth"
    candidates: bool = True
    paths: bool = True
    abreast: bool = False
    """Whether all cloths are shown side by side, and not one of them."""


def to_show(session: Session, at: int) -> list[Shown]:
    """Return the states that can be shown at state `at`: the true one, the estimate, and each net's predictions.

    For the true state and the estimate, `apart` is the distance between the nets' predictions after the whole plan.
    """
    state = session.states[at]
    if at >= len(session.steps):
        return [Shown("outcome" if session.over and at == session.length else "state", state)]
    estimate, plan = session.steps[at]
    if plan is None:
        known = Shown("state", state, candidates=estimate.candidates)
        return [known, known._replace(name="estimate", state=estimate.state, sigma=estimate.sigma, column=1)]
    apart = disagreement(plan)
    end = None if apart is None else apart[-1]
    first = Shown("state", state, None, end, estimate.candidates, plan.manipulations[0])
    found = [first, first._replace(name="estimate", state=estimate.state, sigma=estimate.sigma, column=1)]
    for net, (member, means) in enumerate(zip(plan.members, plan.means, strict=True)):
        for i, mean in enumerate(means):
            name = f"net {member}, after {i + 1}" if len(plan.means) > 1 else f"predicted after {i + 1}"
            sigma = None if plan.sigmas is None else plan.sigmas[net, i]
            then = plan.manipulations[i + 1] if i + 1 < len(plan.manipulations) else None
            found.append(Shown(name, mean, sigma, None if apart is None else apart[i], None, then, 1 + net, i))
    return found


def scale_of(session: Session, mode: Mode) -> Scale:
    """Return one colour scale for a whole session, so that its steps can be compared."""
    every = [shown for at in range(len(session.states)) for shown in to_show(session, at)]
    found = [v for shown in every if (v := values(shown, mode)) is not None]
    highest = max((float(np.quantile(v, 0.995)) for v in found), default=0.0)
    return Scale(mode, colours.round_up(highest / CLOTH_LENGTH) * CLOTH_LENGTH)


def values(shown: Shown, mode: Mode) -> Float[np.ndarray, "u v"] | None:
    """Return the mode's value at each vertex [normalised]; None if it is not known, or the state is no mesh."""
    if not is_mesh(shown.state):
        return None
    if mode == "height":
        return shown.state[..., 2].astype(np.float32)
    if mode == "sigma" and shown.sigma is not None:
        return colours.sigma_of(shown.sigma)
    return shown.apart if mode == "disagreement" else None


def scene_of(session: Session, at: int, view: View) -> Scene:
    """Return the scene of a session at state `at`: the cloth that the view names, or all of them side by side."""
    found = to_show(session, at)
    scale = scale_of(session, view.mode)
    if view.abreast:
        where = [(shown.column * SPACING, -shown.row * SPACING) for shown in found]
        goal_at = (2 * SPACING, 0.0)
    else:
        found = [next((shown for shown in found if shown.name == view.shown), found[0])]
        where, goal_at = [(0.0, 0.0)], (SPACING if view.ghost == "beside it" else 0.0, 0.0)
    parts = [_exhibit(shown, place, scale, view, session) for shown, place in zip(found, where, strict=True)]
    if view.abreast or view.ghost != "hidden":
        parts.append(_goal(session.goal, goal_at, ghost=not view.abreast and view.ghost == "over the cloth"))
    return Scene(
        tuple(cloth for part in parts for cloth in part.cloths),
        tuple(path for part in parts for path in part.paths),
        tuple(dots for part in parts for dots in part.dots),
        tuple(caption for part in parts for caption in part.captions),
        (*where, goal_at),
    )


def _exhibit(shown: Shown, at: tuple[float, float], scale: Scale, view: View, session: Session) -> Scene:
    offset = np.array([*at, 0], np.float32)
    scene = (
        Scene((_cloth(shown, offset, scale),)) if is_mesh(shown.state) else Scene(dots=(cubes(shown.state, offset),))
    )
    if view.paths and shown.manipulation is not None:
        ways = zip(hand_paths(shown.state, shown.manipulation), colours.HANDS, strict=False)
        scene = scene._replace(paths=tuple(Path(points + offset, colour) for points, colour in ways))
    if view.candidates and shown.candidates is not None and len(shown.candidates):
        points = on_top(shown.state, places(shown.state, shown.candidates)) + offset
        painted = _plain(colours.CANDIDATE, (len(points),))
        scene = scene._replace(dots=(*scene.dots, Dots(points, painted, 0.018)))
    off = error_of(shown.state, session.goal, session.cloth)
    text = shown.name if off is None else f"{shown.name} · error {off:.3f}"
    return scene._replace(captions=(Caption(text, offset + _BEFORE),))


def _plain(colour: Colour, shape: tuple[int, ...]) -> np.ndarray:
    return np.broadcast_to(np.array(colour, np.float32), (*shape, 3))


def _cloth(shown: Shown, offset: np.ndarray, scale: Scale) -> Cloth:
    mesh = shown.state.astype(np.float32)
    if scale.mode == "side":
        return Cloth(mesh + offset, _plain(colours.FRONT, mesh.shape[:2]), _plain(colours.BACK, mesh.shape[:2]))
    known = values(shown, scale.mode)
    painted = _plain(colours.UNKNOWN, mesh.shape[:2]) if known is None else colours.colours(known, scale)
    return Cloth(mesh + offset, painted, painted)


def _goal(goal: State, at: tuple[float, float], *, ghost: bool) -> Scene:
    # The ghost is raised, because two surfaces at the same height flicker.
    offset = np.array([*at, 3 * LIFT if ghost else 0], np.float32)
    captions = () if ghost else (Caption("goal", offset + _BEFORE),)
    if not is_mesh(goal):
        return Scene(dots=(cubes(goal, offset),), captions=captions)
    sides = (colours.GHOST, colours.GHOST) if ghost else (colours.FRONT, colours.BACK)
    front, back = (_plain(side, goal.shape[:2]) for side in sides)
    return Scene((Cloth(goal.astype(np.float32) + offset, front, back, 0.4 if ghost else 1.0),), captions=captions)


def hand_paths(state: State, manipulation: Float[np.ndarray, "6"]) -> list[Points]:
    """Return each hand's arc from grasp to release point (eq. 1, section 4.2.2); none for a null manipulation."""
    if bool(is_null(manipulation)):
        return []
    if is_mesh(state):
        grasps = np.stack([np.asarray(to_cartesian(state, uv), np.float32) for uv in grasp_points(manipulation)])
    else:
        grasps = on_top(state, np.stack([np.asarray(xy) for xy in grasp_points(manipulation)]))
    hands = 1 if bool(is_single(manipulation)) else 2
    releases = np.asarray(release_points(grasps[:, :2], np.asarray(displacement(manipulation))).points)
    way = arc(grasps[:hands], releases[:hands])
    return list(np.stack([way.at(share) for share in np.linspace(0, 1, WAYPOINTS)], axis=1).astype(np.float32))


def on_top(state: State, xy: Float[np.ndarray, "points 2"]) -> Points:
    """Place points xy [normalised] on the top layer of a state."""
    if not is_mesh(state):
        return np.column_stack([xy, heights(state, xy)]).astype(np.float32)
    vertices = state.reshape(-1, 3)
    off = np.linalg.norm(vertices[:, :2] - xy[:, None], axis=-1)
    # A vertex that is almost as near as the nearest (by less than a grid spacing) may belong to an upper layer.
    near = off <= off.min(1, keepdims=True) + 0.03
    top = np.where(near, vertices[:, 2], -np.inf).max(1)
    return np.column_stack([xy, top + LIFT]).astype(np.float32)


def cubes(voxels: State, offset: Float[np.ndarray, "3"]) -> Dots:
    """Return the occupied voxels as boxes, coloured by height."""
    occupied = np.argwhere(voxels >= _SURELY)
    size = np.array([2 / RESOLUTION[0], 2 / RESOLUTION[1], HEIGHT / RESOLUTION[2]])
    points = (occupied + 0.5) * size - [1, 1, 0]
    painted = colours.colours(points[:, 2].astype(np.float32), Scale("height", HEIGHT))
    return Dots((points + offset).astype(np.float32), painted.reshape(-1, 3), 2 / RESOLUTION[0], cubes=True)
