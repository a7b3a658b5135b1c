"""Attempts at sequences: three random manipulations, each attempt with its own random seed, and its own cloth."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from clothkit.cloth.silhouette import silhouette
from clothkit.cloth.topology import CLOTH_LENGTH, Topology
from clothkit.manipulation import sampling
from clothkit.manipulation.sampling import draw_hands, sample
from clothkit.simulation.executor import perform
from clothkit.simulation.quality import Quality, measure, reason
from clothkit.simulation.settings import DRAWN, SimulateConfig
from clothkit.simulation.solver import flat_state
from clothkit.simulation.variation import Drawn, Script, draw, opening, script
from clothkit.simulation.world import Motion, Worlds

STEPS = 3
RASTER = 256
EXTENT = 1.1  # normalised, half of the silhouette raster's side


class Attempts(NamedTuple):
    """The results of a block of attempts. Values of states that a rejected attempt did not reach are zero."""

    attempt: Int[np.ndarray, " attempts"]
    accepted: Bool[np.ndarray, " attempts"]
    reason: np.ndarray
    """Text [attempts]: the reason for a rejection; empty if accepted."""
    reached: Int[np.ndarray, " attempts"]
    """Number of states, including the first one and the rejected one."""
    start: np.ndarray
    """Text [attempts]: how the cloth came to lie as it did at first, one of STARTS."""
    goal: np.ndarray
    """Text [attempts]: the named goal whose folds come first; empty if all are random."""
    sides: Float[np.ndarray, "attempts 2"]
    """Sides of the flat cloth along u and along v, in metres."""
    material: Float[np.ndarray, "attempts properties"]
    """The properties of the material that can be drawn, in the order and units of DRAWN."""
    states: Float[np.ndarray, "attempts 4 u v 3"]
    """Metres, world frame."""
    manipulation: Float[np.ndarray, "attempts 3 6"]
    hands: Int[np.ndarray, "attempts 3"]
    releases: Float[np.ndarray, "attempts 3 2 2"]
    """Metres."""
    settle_time: Float[np.ndarray, "attempts 3"]
    residual_speed: Float[np.ndarray, "attempts 4"]
    height: Float[np.ndarray, "attempts 4"]
    strain_p99: Float[np.ndarray, "attempts 4"]
    strain_worst: Float[np.ndarray, "attempts 4"]
    intersections: Int[np.ndarray, "attempts 4"]
    gap: Float[np.ndarray, "attempts 4"]
    area: Float[np.ndarray, "attempts 4"]
    """Area of the silhouette, as a fraction of the flat cloth's."""
    folds: Int[np.ndarray, "attempts 4"]


MEASURED = ("height", "strain_p99", "strain_worst", "intersections", "gap")


def attempt_sequences(numbers: range, settings: SimulateConfig, topology: Topology | None = None) -> Attempts:
    """Run the attempts with these numbers. Each result depends only on the seed and the attempt's number.

    Without a topology, the cloth is the square of `settings.simulation`; with `settings.variation`, each attempt draws
    its own.
    """
    simulation, variation = settings.simulation, settings.variation
    if variation is None:
        return _attempt(numbers, settings, Drawn(simulation, topology or simulation.topology, "flat"))
    found = []
    for number in numbers:
        drawn = draw(simulation, variation, seed=settings.seed, number=number)
        first = opening(drawn, variation.starts, seed=settings.seed, number=number)
        told = script(drawn, variation.named, seed=settings.seed, number=number)
        own = replace(settings, simulation=drawn.simulation)
        found.append(_attempt(range(number, number + 1), own, drawn, first, told))
    return Attempts(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _attempt(
    numbers: range, settings: SimulateConfig, drawn: Drawn, first: Motion | None = None, told: Script | None = None
) -> Attempts:
    """Run attempts with one cloth, which is first moved as `first` says, and then manipulated as it was told."""
    simulation, topology, count = settings.simulation, drawn.topology, len(numbers)
    scale = simulation.cloth_side / CLOTH_LENGTH
    rngs = [np.random.default_rng([settings.seed, number]) for number in numbers]
    worlds = Worlds(count, simulation, topology)
    found = _empty(numbers, drawn, told.goal if told else "")
    found.states[:, 0] = flat_state(simulation, topology)
    flat = float(np.ptp(found.states[0, 0, ..., 0]))
    if first is not None:
        opened = worlds.execute(found.states[:, 0], first)
        found.states[:, 0] = opened.states
        found.residual_speed[:, 0] = opened.residual_speed
    quality = measure(found.states[:, 0], simulation, topology)
    _note(found, np.arange(count), 0, quality, topology, flat)
    if first is not None:
        found.reason[:] = [reason(quality, opened, settings, index) for index in range(count)]
    for step in range(STEPS):
        open_ = np.flatnonzero(found.reason == "")
        moves: list[sampling.Drawn | None] = []
        for index in open_:
            mesh = (found.states[index, step] / np.float32(scale)).astype(np.float32)
            if told and step < len(told.manipulations):
                moves.append(_told(told.manipulations[step], topology))
            else:
                hands = draw_hands(rngs[index], settings.sampling)
                moves.append(sample(rngs[index], mesh, hands, settings.sampling, settings.candidates, topology))
            if moves[-1] is None:
                found.reason[index] = "no manipulation"
        chosen = [(index, move) for index, move in zip(open_, moves, strict=True) if move is not None]
        if not chosen:
            break
        indices = np.array([index for index, _ in chosen])
        before = found.states[indices, step]
        points = [before[k].reshape(-1, 3)[list(move.vertices), :2] for k, (_, move) in enumerate(chosen)]
        displacement = np.array([move.displacement for _, move in chosen]).astype(np.float32)
        single = np.array([move.single for _, move in chosen])
        taken, outcome = perform(worlds, before, np.array(points), to_metres(displacement, scale), single)
        quality = measure(outcome.states, simulation, topology)
        found.states[indices, step + 1] = outcome.states
        found.settle_time[indices, step] = outcome.settle_time
        found.residual_speed[indices, step + 1] = outcome.residual_speed
        found.hands[indices, step] = np.where(single, 1, 2)
        found.releases[indices, step] = [hands.releases for hands in taken]
        vertices = np.array([hands.vertices[:, 0] for hands in taken])
        vertices[:, 1] = np.where(single, vertices[:, 0], vertices[:, 1])
        uv = topology.geodesic().reshape(-1, 2)[vertices].reshape(-1, 4)
        found.manipulation[indices, step] = np.concatenate([uv, displacement], axis=1)
        _note(found, indices, step + 1, quality, topology, flat)
        for k, index in enumerate(indices):
            found.reason[index] = reason(quality, outcome, settings, k)
    return found._replace(accepted=found.reason == "")


def _told(manipulation: Float[np.ndarray, "6"], topology: Topology) -> sampling.Drawn:
    """The manipulation, by the vertices nearest to its grasp points in the cloth."""
    uv = topology.geodesic().reshape(-1, 2)
    first, second = (int(np.argmin(((uv - point) ** 2).sum(1))) for point in (manipulation[:2], manipulation[2:4]))
    return sampling.Drawn((first, second), manipulation[4:])


def to_metres(displacement: Float[np.ndarray, "*batch 2"], scale: float) -> Float[np.ndarray, "*batch 2"]:
    """Convert a recorded displacement (float32, normalised) to metres, with the same bits wherever it is executed."""
    return np.asarray(displacement, np.float64) * scale


def folds(mesh: Float[np.ndarray, "u v 3"]) -> int:
    """Return the number of connected creases.

    A quad is creased if the normals of the quads before and after it, along u or v, differ by more than 90 degrees.
    Creased quads are connected if they share a side or a corner.
    """
    down, right = mesh[1:, 1:] - mesh[:-1, :-1], mesh[1:, :-1] - mesh[:-1, 1:]
    normal = np.cross(right, down)
    creased = np.zeros(normal.shape[:2], bool)
    creased[1:-1] |= (normal[:-2] * normal[2:]).sum(-1) < 0
    creased[:, 1:-1] |= (normal[:, :-2] * normal[:, 2:]).sum(-1) < 0
    return int(ndimage.label(creased, structure=np.ones((3, 3)))[1])


def _empty(numbers: range, drawn: Drawn, goal: str) -> Attempts:
    count, states, shape = len(numbers), STEPS + 1, drawn.topology.shape
    settings = drawn.simulation
    sides = settings.sides(drawn.topology)
    material = [getattr(settings.material, name) for name in DRAWN]

    def zeros(*shape: int, kind: type = np.float32) -> np.ndarray:
        return np.zeros((count, *shape), kind)

    return Attempts(
        attempt=np.array(numbers, np.int64),
        accepted=zeros(kind=bool),
        reason=np.full(count, "", "<U16"),
        reached=zeros(kind=np.int32),
        start=np.full(count, drawn.start, "<U16"),
        goal=np.full(count, goal, "<U32"),
        sides=np.tile(sides, (count, 1)),
        material=np.tile(material, (count, 1)).astype(np.float32),
        states=zeros(states, *shape, 3),
        manipulation=zeros(STEPS, 6),
        hands=zeros(STEPS, kind=np.int32),
        releases=zeros(STEPS, 2, 2),
        settle_time=zeros(STEPS),
        residual_speed=zeros(states),
        height=zeros(states),
        strain_p99=zeros(states),
        strain_worst=zeros(states),
        intersections=zeros(states, kind=np.int32),
        gap=zeros(states),
        area=zeros(states),
        folds=zeros(states, kind=np.int32),
    )


def _note(found: Attempts, indices: np.ndarray, state: int, quality: Quality, topology: Topology, flat: float) -> None:
    """Record the measurements of a state; `flat` is the flat cloth's side along u, in metres."""
    for name in MEASURED:
        getattr(found, name)[indices, state] = getattr(quality, name)
    found.reached[indices] = state + 1
    along_u, along_v = topology.sides
    scale = along_u / flat
    pixel = 2 * EXTENT / RASTER
    for index in indices[quality.finite]:
        mesh = found.states[index, state] * scale
        middle = (mesh.max((0, 1)) + mesh.min((0, 1))) / 2
        covered = silhouette((mesh - middle).astype(np.float32), resolution=RASTER, extent=EXTENT)
        found.area[index, state] = covered.sum() * pixel**2 / (along_u * along_v)
        found.folds[index, state] = folds(mesh)
