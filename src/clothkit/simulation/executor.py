"""Execution of manipulations, given by grasp points and displacements, by a pool of workers (design 6.11).

The simulation stage and the planner share `perform`, so a recorded manipulation, executed from its recorded state,
gives the recorded outcome to the last bit.
"""

import atexit
import functools
from collections.abc import Callable
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from clothkit.cloth.topology import CLOTH_LENGTH, Topology
from clothkit.manipulation.geometry import release_points, topmost_vertex
from clothkit.runtime.dask_pool import DaskPool
from clothkit.simulation.cloths import Cloths
from clothkit.simulation.processes import Kind, ProcessPool, cores, open_pool
from clothkit.simulation.settings import SimulateConfig, SimulationConfig
from clothkit.simulation.world import Outcome, Worlds, arcs

LAYERS = 16  # the most layers that a hand can grasp
WORTH_A_WORKER = 2  # the fewest worlds for which another process is started


class Hands(NamedTuple):
    """The grasped vertices and the release points of one world's hands."""

    vertices: Int[np.ndarray, "2 layers"]
    """Vertices that each hand grasps, numbered row by row, the topmost first, -1 for none."""
    releases: Float[np.ndarray, "2 2"]
    """Release points xy, in metres."""


def grasp(mesh: Float[np.ndarray, "u v 3"], xy: Float[np.ndarray, "2"], *, within: float) -> int:
    """Return the vertex that a hand grasps at xy: the topmost within `within` of the nearest vertex.

    The search is repeated from the vertex found until the result stays the same, so that a hand placed at a grasped
    vertex grasps this same vertex. All lengths are in one unit of any kind.
    """
    vertices = mesh.reshape(-1, 3)
    vertex = topmost_vertex(mesh, xy, within=within)
    while True:
        above = topmost_vertex(mesh, vertices[vertex, :2], within=within)
        if vertices[above, 2] <= vertices[vertex, 2]:
            return vertex
        vertex = above


def place_hands(
    mesh: Float[np.ndarray, "u v 3"],
    grasps: Float[np.ndarray, "2 2"],
    displacement: Float[np.ndarray, "2"],
    single: bool,
    settings: SimulationConfig,
    topology: Topology | None = None,
) -> Hands:
    """Return the grasped vertices and their release points by eq. (1); all lengths are in metres.

    A hand grasps within half of the larger grid spacing. Eq. (1) is evaluated at the positions of the grasped vertices.
    It is applied even if the hands fall on different sides of m.
    """
    points = grasps[:1] if single else grasps
    within = max(settings.spacing(topology or settings.topology)) / 2
    taken = [grasp(mesh, point, within=within) for point in points]
    places = mesh.reshape(-1, 3)[[taken[0], taken[-1]], :2].astype(np.float64)
    releases = np.asarray(release_points(places, displacement.astype(np.float64)).points, np.float32)
    vertices = np.full((2, LAYERS), -1)
    for hand, vertex in enumerate(taken):
        below = layers_below(mesh, vertex, within=within) if settings.grasp == "all" else []
        column = [vertex, *below][:LAYERS]
        vertices[hand, : len(column)] = column
    return Hands(vertices, releases)


def layers_below(mesh: Float[np.ndarray, "u v 3"], vertex: int, *, within: float) -> list[int]:
    """Return, for every layer below a grasped vertex, the layer's vertex nearest to it in xy, from the top down.

    A layer is a connected patch of grid vertices within twice `within` in xy. All lengths are in one unit of any kind.
    """
    vertices = mesh.reshape(-1, 3)
    distance = np.linalg.norm(vertices[:, :2] - vertices[vertex, :2], axis=-1)
    patches, count = ndimage.label((distance <= 2 * within).reshape(mesh.shape[:2]), structure=np.ones((3, 3)))
    labels = patches.ravel()
    nearest = [np.flatnonzero(labels == k)[distance[labels == k].argmin()] for k in range(1, count + 1)]
    below = [int(k) for k in nearest if labels[k] != labels[vertex] and vertices[k, 2] < vertices[vertex, 2]]
    return sorted(below, key=lambda k: -vertices[k, 2])


def perform(
    worlds: Worlds,
    states: Float[np.ndarray, "worlds u v 3"],
    grasps: Float[np.ndarray, "worlds 2 2"],
    displacements: Float[np.ndarray, "worlds 2"],
    single: Bool[np.ndarray, " worlds"],
) -> tuple[list[Hands], Outcome]:
    """Execute a manipulation in each world; return the hands and the outcome, in metres and in the world frame."""
    hands = [
        place_hands(*arguments, worlds.settings, worlds.topology)
        for arguments in zip(states, grasps, displacements, single.tolist(), strict=True)
    ]
    vertices = np.array([h.vertices for h in hands], int).reshape(-1, 2, LAYERS)
    releases = np.array([h.releases for h in hands], float).reshape(-1, 2, 2)
    return hands, worlds.execute(states, arcs(states, vertices, releases, worlds.settings))


def execute(
    meshes: Float[np.ndarray, "worlds u v 3"],
    grasp_xy: Float[np.ndarray, "worlds 2 2"],
    displacement: Float[np.ndarray, "worlds 2"],
    single: Bool[np.ndarray, " worlds"],
    cloths: Cloths | None = None,
    *,
    settings: SimulationConfig,
    workers: int = 0,
    executor: Kind = "processes",
    scheduler: str = "",
    topology: Topology | None = None,
) -> Float[np.ndarray, "worlds u v 3"]:
    """Execute one manipulation per mesh and return the resulting meshes; all normalised, in the world frame.

    Single-handed manipulations (`single`) use the first grasp point. The outcome depends neither on `workers`
    (0: all cores) nor on who executes it (see `open_pool`) nor on the other worlds. Without `cloths`, all cloths have
    the topology, or are the square of `settings`. Raises InputError if a cluster can't be reached or is lost.
    """
    scale = settings.cloth_side / CLOTH_LENGTH
    states = (np.asarray(meshes, np.float64) * scale).astype(np.float32)
    grasps = np.asarray(grasp_xy, np.float64) * scale
    moves = np.asarray(displacement, np.float64) * scale
    most = max(1, len(states) // WORTH_A_WORKER)
    pool: ProcessPool | DaskPool | None = None
    if executor == "dask":
        pool = _shared_pool(executor, workers or cores(), scheduler)
        parts = min(pool.width, most)
    else:
        parts = min(workers or cores(), most)
        if parts > 1:
            pool = _shared_pool(executor, parts, scheduler)
    if pool is None:
        final = _run(settings, topology, cloths, states, grasps, moves, single)
    else:
        # Interleaved, so that the parts cost about the same.
        indices = [np.arange(part, len(states), parts) for part in range(parts)]
        parts_of = [None if cloths is None else Cloths(*(part[i] for part in cloths)) for i in indices]
        final = np.empty_like(states)
        try:
            jobs = [
                pool.submit(_run, settings, topology, own, states[i], grasps[i], moves[i], single[i])
                for i, own in zip(indices, parts_of, strict=True)
            ]
            for index, job in zip(indices, jobs, strict=True):
                final[index] = job.result()
        except BrokenExecutor:
            end_workers()  # A pool that has lost a process takes no more work: the next call needs another one.
            raise
    return (final.astype(np.float64) / scale).astype(np.float32)


def _run(
    settings: SimulationConfig,
    topology: Topology | None,
    cloths: Cloths | None,
    states: np.ndarray,
    grasps: np.ndarray,
    moves: np.ndarray,
    single: np.ndarray,
) -> np.ndarray:
    same = (settings, topology or settings.topology)
    worlds = [same if cloths is None else cloths.world(row, settings) for row in range(len(states))]
    final = np.empty_like(states)
    for world in dict.fromkeys(worlds):
        rows = np.array([row for row, other in enumerate(worlds) if other == world])
        _, outcome = perform(_worlds(*world, len(rows)), *(part[rows] for part in (states, grasps, moves, single)))
        final[rows] = outcome.states
    return final


@functools.lru_cache(maxsize=2)
def _worlds(settings: SimulationConfig, topology: Topology, count: int) -> Worlds:
    return Worlds(count, settings, topology)


def make_simulator(settings: SimulateConfig) -> Callable[..., Float[np.ndarray, "worlds u v 3"]]:
    """`execute` with the world and the workers of the stage `simulate`."""
    return functools.partial(
        execute,
        settings=settings.simulation,
        workers=settings.workers,
        executor=settings.executor,
        scheduler=settings.scheduler,
    )


def _shared_pool(kind: Kind, workers: int, scheduler: str) -> ProcessPool | DaskPool:
    if (kind, workers, scheduler) not in _pools:
        stack = ExitStack()
        pool = stack.enter_context(open_pool(kind, workers=workers, scheduler=scheduler))
        _pools[kind, workers, scheduler] = stack, pool
    return _pools[kind, workers, scheduler][1]


_pools: dict[tuple[Kind, int, str], tuple[ExitStack, ProcessPool | DaskPool]] = {}


@atexit.register
def end_workers() -> None:
    """End the worker processes; from then on their CPU time counts as that of this process's children."""
    while _pools:
        _pools.popitem()[1][0].close()
