"""Named goals in the simulator: their folds are executed so that what shall meet does meet (sections 4.2.2 and 4.5)."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from clothkit.cloth.topology import CLOTH_LENGTH, Topology
from clothkit.manipulation.geometry import to_cartesian
from clothkit.manipulation.named_folds import Folds, Goal, Grasps, Layout, layout
from clothkit.manipulation.vector import SHORTEST
from clothkit.runtime.errors import InputError
from clothkit.simulation.executor import perform
from clothkit.simulation.quality import measure, reason
from clothkit.simulation.settings import Limits, SimulateConfig, SimulationConfig
from clothkit.simulation.solver import flat_state
from clothkit.simulation.world import Worlds

SLIDES = 0.08
"""Share of the way that cloth slides on once it is let go; a first guess, which the tries correct."""

CAREFUL = 0.15
"""Highest speed of the hands [m/s]: layers that are held together slide less than at the speed of the data."""

TRIES = 5
"""Most displacements that are tried for a fold."""

CLOSE = 0.005
"""Distance from its place at which what the hands held is close enough, along their way [cloth length]."""

GOOD = 0.01
"""Distance of the vertices from their places up to which no other grasps are tried, root mean square [cloth length]."""

MOST = 0.06
"""The same beyond which what came about is not the goal: thick cloth in many layers slides apart."""

LIMITS = Limits(height=2.0)
"""What a clean state keeps to; many layers may lie as high as they do."""


class Made(NamedTuple):
    """A goal, and how it came about."""

    states: Float[np.ndarray, "states u v 3"]
    """The flat cloth and the cloth after each manipulation [normalised], at their place on the table."""
    manipulations: Float[np.ndarray, "steps 6"]


def make(goal: Goal, topology: Topology, simulation: SimulationConfig) -> Made:
    """Fold a flat cloth to a goal by hands that grasp all layers.

    Cloth that is let go slides on, so each fold is tried with several displacements, until what the hands held lies
    within CLOSE of its place, or TRIES times; and with other grasps, if the fold has any, until its vertices lie within
    GOOD of their places. The fold whose vertices lie nearest is taken. Raises InputError if a manipulation would be
    null, if no try leaves the cloth clean (at rest, without intersections, and within LIMITS), or its vertices within
    MOST of their places.
    """
    settings = careful(simulation)
    worlds = Worlds(1, settings, topology)
    folds = goal.folds(topology)
    states, manipulations = [flat_state(settings, topology)], []
    for number in range(len(folds)):
        name = f"goal {goal.name}, fold {number + 1}"
        best = _best_fold(worlds, states[-1], topology, folds[: number + 1], name)
        states.append(best.mesh)
        manipulations.append([*best.grasps[0], *best.grasps[-1], *best.displacement])
    scale = CLOTH_LENGTH / settings.cloth_side
    return Made((np.stack(states) * np.float32(scale)).astype(np.float32), np.array(manipulations, np.float32))


def careful(simulation: SimulationConfig) -> SimulationConfig:
    """The world in which goals are made: its hands are slow and grasp all layers."""
    return dataclasses.replace(simulation, grasp="all", hand_speed=min(simulation.hand_speed, CAREFUL))


class _Try(NamedTuple):
    """A fold as it was tried."""

    grasps: Grasps
    displacement: Float[np.ndarray, "2"]
    """Normalised."""
    mesh: Float[np.ndarray, "u v 3"]
    """The outcome [m]."""
    unclean: str
    """Why it is not clean; empty if it is."""
    off: float
    """Distance of the vertices from their places in x and y, root mean square [cloth length]."""


def _best_fold(worlds: Worlds, state: Float[np.ndarray, "u v 3"], topology: Topology, folds: Folds, name: str) -> _Try:
    """The best try of the last of the folds, from the state before it [m]."""
    tries: list[_Try] = []
    for grasps in (folds[-1].grasps, *folds[-1].others):
        tries += _tries(worlds, state, topology, folds, grasps, name)
        clean = [one for one in tries if not one.unclean]
        if clean and min(one.off for one in clean) <= GOOD:
            break
    if not clean:
        raise InputError(f"{name}: no try left this cloth clean ({tries[-1].unclean})")
    best = min(clean, key=lambda one: one.off)
    if best.off > MOST:
        raise InputError(
            f"{name}: the closest try is {best.off:.2f} cloth lengths off, expected at most {MOST:g}; "
            "this cloth slides apart, or is too thick"
        )
    return best


def _tries(
    worlds: Worlds, state: Float[np.ndarray, "u v 3"], topology: Topology, folds: Folds, grasps: Grasps, name: str
) -> list[_Try]:
    """Tries of the last of the folds with some grasps, each with another displacement."""
    settings, side = worlds.settings, worlds.settings.cloth_side
    scale = side / CLOTH_LENGTH
    before, after = layout(topology, folds[:-1]), layout(topology, folds)
    uv = np.array(grasps, np.float32)
    hands_at = np.asarray(to_cartesian(np.broadcast_to(state, (len(uv), *state.shape)), uv), float)[:, :2]
    images = _placed(layout(topology, folds, uv).xy * scale, before, state, scale)
    way = (images - hands_at).mean(0)
    distance = float(np.linalg.norm(way))
    if distance / scale < SHORTEST:
        raise InputError(
            f"{name}: moves the cloth by {distance / side:.2f} cloth lengths, expected at least "
            f"{SHORTEST / CLOTH_LENGTH:g}, the least that is no null manipulation; the cloth is too narrow"
        )
    ahead, pair = way / distance, hands_at[[0, -1]]
    limits = SimulateConfig(sequences=1, simulation=settings, limits=LIMITS)
    found: list[_Try] = []
    tried: list[tuple[float, float]] = []
    length, beyond = (1 - SLIDES) * distance, np.inf
    while len(tried) < TRIES and abs(beyond) > CLOSE * side:
        hands, outcome = perform(worlds, state[None], pair[None], (length * ahead)[None], np.array([len(uv) == 1]))
        mesh = outcome.states[0]
        unclean = reason(measure(outcome.states, settings, topology), outcome, limits, 0)
        if not np.isfinite(mesh).all():
            found.append(_Try(grasps, length * ahead / scale, mesh, unclean, np.inf))
            break
        away = mesh[..., :2] - _placed(after.xy * scale, after, mesh, scale)
        held = np.concatenate([hand[hand >= 0] for hand in hands[0].vertices])
        beyond = float((away.reshape(-1, 2)[held] @ ahead).mean())
        off = float(np.sqrt((away**2).sum(-1).mean())) / side
        found.append(_Try(grasps, length * ahead / scale, mesh, unclean, off))
        tried.append((length, beyond))
        length = _next(tried)
    return found


def _next(tried: list[tuple[float, float]]) -> float:
    """The displacement to be tried next, by the secant through the last two tries."""
    length, beyond = tried[-1]
    slope = 1.0
    if len(tried) > 1 and tried[-2][0] != length:
        slope = float(np.clip((beyond - tried[-2][1]) / (length - tried[-2][0]), 0.5, 2))
    return length - beyond / slope


def _placed(
    places: Float[np.ndarray, "*places 2"], ideal: Layout, mesh: Float[np.ndarray, "u v 3"], scale: float
) -> Float[np.ndarray, "*places 2"]:
    """Places [m] of the plane in which the flat cloth lay, moved as the points that no fold moves have moved since."""
    still = ~ideal.moved
    turn, shift = rigid(ideal.xy[still] * scale, mesh[still][:, :2].astype(float))
    return places @ turn.T + shift


def rigid(
    points: Float[np.ndarray, "points 2"], images: Float[np.ndarray, "points 2"]
) -> tuple[Float[np.ndarray, "2 2"], Float[np.ndarray, "2"]]:
    """The rotation and the shift that bring points nearest to their images in the mean square (Kabsch 1976)."""
    a, b = points - points.mean(0), images - images.mean(0)
    cosine, sine = float((a * b).sum()), float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    turn = np.array([[cosine, -sine], [sine, cosine]]) / max(np.hypot(cosine, sine), 1e-12)
    return turn, images.mean(0) - turn @ points.mean(0)
