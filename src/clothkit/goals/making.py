"""Named goals in the simulator: their folds are executed so that what shall meet does meet (sections 4.2.2 and 4.5)."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from clothkit.cloth.topology import CLOTH_LENGTH, Topology
from clothkit.goals.folds import Folds, Goal, Layout, layout
from clothkit.manipulation.geometry import to_cartesian
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
"""Distance from its place at which a fold is close enough, along the way of the hands [cloth length]."""

LIMITS = Limits(height=2.0)
"""What a clean state keeps to; many layers may lie as high as they do."""


class Made(NamedTuple):
    """A goal, and how it came about."""

    states: Float[np.ndarray, "states u v 3"]
    """The flat cloth and the cloth after each manipulation [normalised], at their place on the table."""
    manipulations: Float[np.ndarray, "steps 6"]


def make(goal: Goal, topology: Topology, simulation: SimulationConfig) -> Made:
    """Fold a flat cloth to a goal by hands that grasp all layers.

    Cloth that is let go slides on, so each fold is tried again with another displacement until its hands' points come
    to lie within CLOSE of their places, or TRIES times; the closest is taken. Raises InputError if a manipulation would
    be null, or no try leaves the cloth clean: at rest, without intersections, and within LIMITS.
    """
    settings = careful(simulation)
    worlds = Worlds(1, settings, topology)
    folds = goal.folds(topology)
    states, manipulations = [flat_state(settings, topology)], []
    for number, fold in enumerate(folds):
        done = folds[: number + 1]
        mesh, displacement = _folded(worlds, states[-1], topology, done, f"goal {goal.name}, fold {number + 1}")
        states.append(mesh)
        first, last = fold.grasps[0], fold.grasps[-1]
        manipulations.append([*first, *last, *displacement])
    scale = CLOTH_LENGTH / settings.cloth_side
    return Made((np.stack(states) * np.float32(scale)).astype(np.float32), np.array(manipulations, np.float32))


def careful(simulation: SimulationConfig) -> SimulationConfig:
    """The world in which goals are made: its hands are slow and grasp all layers."""
    return dataclasses.replace(simulation, grasp="all", hand_speed=min(simulation.hand_speed, CAREFUL))


def _folded(
    worlds: Worlds, state: Float[np.ndarray, "u v 3"], topology: Topology, folds: Folds, name: str
) -> tuple[Float[np.ndarray, "u v 3"], Float[np.ndarray, "2"]]:
    """The cloth [m] after the last of the folds, from the state before it, and its displacement [normalised]."""
    scale = worlds.settings.cloth_side / CLOTH_LENGTH
    fold, before, after = folds[-1], layout(topology, folds[:-1]), layout(topology, folds)
    geodesic = np.array(fold.grasps, np.float32)
    grasps = np.asarray(to_cartesian(np.broadcast_to(state, (len(geodesic), *state.shape)), geodesic), float)[:, :2]
    images = _placed(layout(topology, folds, geodesic).xy * scale, before, state, scale)
    way = (images - grasps).mean(0)
    distance, ahead = float(np.linalg.norm(way)), way / np.linalg.norm(way)
    if distance / scale < SHORTEST:
        raise InputError(
            f"{name}: moves the cloth by {distance / scale / CLOTH_LENGTH:.2f} cloth lengths, expected at least "
            f"{SHORTEST / CLOTH_LENGTH:g}, the least that is no null manipulation; the cloth is too narrow"
        )
    tried: list[tuple[float, float]] = []
    best, found, why = np.inf, None, ""
    length = (1 - SLIDES) * distance
    for _ in range(TRIES):
        both = np.stack([grasps[0], grasps[-1]])
        hands, outcome = perform(worlds, state[None], both[None], (length * ahead)[None], np.array([len(grasps) == 1]))
        mesh = outcome.states[0]
        held = np.concatenate([hand[hand >= 0] for hand in hands[0].vertices])
        shall = after.xy.reshape(-1, 2)[held] * scale
        settings = SimulateConfig(sequences=1, simulation=worlds.settings, limits=LIMITS)
        unclean = reason(measure(outcome.states, worlds.settings, topology), outcome, settings, 0)
        if not np.isfinite(mesh).all():
            why = unclean
            break
        beyond = float(((mesh.reshape(-1, 3)[held, :2] - _placed(shall, after, mesh, scale)) @ ahead).mean())
        tried.append((length, beyond))
        if unclean:
            why = unclean
        elif abs(beyond) < best:
            best, found = abs(beyond), (mesh, length)
        if best <= CLOSE * worlds.settings.cloth_side:
            break
        length = _next(tried)
    if found is None:
        raise InputError(f"{name}: no try left this cloth clean ({why})")
    return found[0], found[1] * ahead / scale


def _next(tried: list[tuple[float, float]]) -> float:
    """The displacement to be tried next, by the secant through the last two tries."""
    length, beyond = tried[-1]
    slope = 1.0
    if len(tried) > 1 and tried[-2][0] != length:
        slope = float(np.clip((beyond - tried[-2][1]) / (length - tried[-2][0]), 0.5, 2))
    return length - beyond / slope


def _placed(
    places: Float[np.ndarray, "places 2"], ideal: Layout, mesh: Float[np.ndarray, "u v 3"], scale: float
) -> Float[np.ndarray, "places 2"]:
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
