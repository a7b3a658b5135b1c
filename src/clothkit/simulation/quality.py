"""Quality checks of states at rest: the measurements, and the first limit that a state breaks."""

from typing import NamedTuple

import numpy as np
import warp as wp
from jaxtyping import Bool, Float, Int

from clothkit.cloth.topology import CLOTH_LENGTH, Topology, edges, triangles
from clothkit.simulation.kernels.inspection import count_intersections, measure_gaps
from clothkit.simulation.settings import SimulateConfig, SimulationConfig
from clothkit.simulation.solver import SHORTEST_CHORD
from clothkit.simulation.world import Outcome

GAP_REACH = 3.0  # of the smaller grid spacings, the largest gap that is measured; about that of a flat cloth


class Quality(NamedTuple):
    """Measurements on each state."""

    finite: Bool[np.ndarray, " states"]
    lowest: Float[np.ndarray, " states"]
    """Height of the lowest vertex above the table, in metres."""
    height: Float[np.ndarray, " states"]
    """Height of the highest vertex, normalised."""
    strain_p99: Float[np.ndarray, " states"]
    """99th percentile of the strain of the grid's edges, without the diagonals: their length over that at rest, less 1.

    A shorter edge counts by as much as it is shorter than the chord of a thread that turns, within the edge, from the
    direction of the edge before to that of the edge after it; at the border, than at rest."""
    strain_worst: Float[np.ndarray, " states"]
    intersections: Int[np.ndarray, " states"]
    """Number of pairs of an edge (diagonals included) and a triangle pierced by it that share no vertex."""
    gap: Float[np.ndarray, " states"]
    """Smallest distance of a vertex to the surface outside its two-ring, in metres, at most three of the smaller grid
    spacings.

    The surface outside the two-ring is all triangles without a vertex at most two rows and two columns away."""


def measure(
    states: Float[np.ndarray, "states u v 3"], settings: SimulationConfig, topology: Topology | None = None
) -> Quality:
    """Measure states given in metres. States that aren't finite are measured as if all vertices were at the origin."""
    spacing = settings.spacing(topology or settings.topology)
    finite = np.isfinite(states).all((1, 2, 3))
    usable = np.where(finite[:, None, None, None], states, np.float32(0))
    strain = _strain(usable, spacing)
    return Quality(
        finite,
        usable[..., 2].min((1, 2)),
        usable[..., 2].max((1, 2)) * np.float32(CLOTH_LENGTH / settings.cloth_side),
        np.percentile(strain, 99, axis=1).astype(np.float32),
        strain.max(1),
        intersections(usable),
        gaps(usable, reach=GAP_REACH * min(spacing)),
    )


def reason(quality: Quality, outcome: Outcome, settings: SimulateConfig, index: int) -> str:
    """Return the first reason to reject the state at `index`, or an empty string if it is accepted."""
    limits = settings.limits
    checks = {
        "not finite": not quality.finite[index],
        "out of steps": outcome.spent[index],
        "not at rest": not outcome.rested[index] or outcome.residual_speed[index] > limits.residual_speed,
        "below table": quality.lowest[index] < -limits.below_table,
        "intersections": quality.intersections[index] > limits.intersections,
        "layers too close": quality.gap[index] < limits.gap * settings.simulation.material.thickness,
        "too high": quality.height[index] > limits.height,
        "strained": quality.strain_p99[index] > limits.strain_p99 or quality.strain_worst[index] > limits.strain_worst,
    }
    return next((name for name, broken in checks.items() if broken), "")


def intersections(states: Float[np.ndarray, "states u v 3"]) -> Int[np.ndarray, " states"]:
    """Return how many pairs of an edge and a triangle of the grid pierce each other, over all such pairs."""
    shape = states.shape[1:3]
    return pierced(states.reshape(len(states), -1, 3), edges(shape), triangles(shape))


def pierced(
    states: Float[np.ndarray, "states vertices 3"],
    ends: Int[np.ndarray, "edges 2"],
    corners: Int[np.ndarray, "triangles 3"],
) -> Int[np.ndarray, " states"]:
    """Return how many pairs of an edge and a triangle pierce each other, for any triangulation."""
    counts = wp.zeros((len(states), len(ends)), dtype=int)
    inputs = [_vertices(states), _numbers(ends), _numbers(corners), counts]
    if len(states):
        wp.launch(count_intersections, dim=counts.shape, inputs=inputs)
    return counts.numpy().sum(1)


def gaps(states: Float[np.ndarray, "states u v 3"], *, reach: float) -> Float[np.ndarray, " states"]:
    """Return the smallest distance of a vertex to the surface outside its two-ring, at most `reach`, in its unit."""
    rows, columns = states.shape[1:3]
    found = wp.zeros((len(states), rows * columns), dtype=float)
    inputs = [_vertices(states), _numbers(triangles((rows, columns))), columns, reach, found]
    if len(states):
        wp.launch(measure_gaps, dim=found.shape, inputs=inputs)
    return found.numpy().min(1)


def _vertices(states: np.ndarray) -> wp.array:
    flat = np.ascontiguousarray(states, np.float32).reshape(len(states), -1, 3)
    return wp.array(flat, dtype=wp.vec3)


def _numbers(values: np.ndarray) -> wp.array:
    return wp.array(values.astype(np.int32), dtype=int)


def _strain(states: np.ndarray, spacing: tuple[float, float]) -> Float[np.ndarray, "states edges"]:
    lines = (states.transpose(0, 2, 1, 3), states)
    return np.concatenate([_along(each, rest) for each, rest in zip(lines, spacing, strict=True)], axis=1)


def _along(states: np.ndarray, rest: float) -> Float[np.ndarray, "states edges"]:
    """The strains of the edges along grid lines, which are the second last axis."""
    edges = np.diff(states, axis=-2) / np.float32(rest)
    length = np.linalg.norm(edges, axis=-1)
    chord = np.ones_like(length)
    turn = np.sum(edges[..., :-2, :] * edges[..., 2:, :], axis=-1)
    chord[..., 1:-1] = np.sqrt(np.clip((1 + turn) / 2, SHORTEST_CHORD**2, 1))
    return np.maximum(length - 1, np.maximum(chord - length, 0)).reshape(len(states), -1).astype(np.float32)
