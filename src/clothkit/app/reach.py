"""Plans within a robot's reach: as they are found, turned by a symmetry of the cloth, or searched for within it.

A plan that is in reach stays as it is. Otherwise its turned and mirrored forms are tried, which cost nothing. If none
of them is in reach, a search with the limits as terms of its objective looks for another plan: first for the goal of
the form that is the nearest to being in reach and, if what is found is much worse than the plan without limits, for
the goal as it is.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from clothkit.app.describe import paths_of
from clothkit.app.options import corners, ordered
from clothkit.app.planner import Planned, State, planned_of, turned_goal, turned_plan
from clothkit.app.settings import AppConfig, BallConfig
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.manipulation.geometry import to_cartesian
from clothkit.manipulation.vector import is_null
from clothkit.observation.pose import Pose
from clothkit.observation.waypoints import MotionConfig, ReachConfig, symmetries
from clothkit.planning.planner import Planner
from clothkit.planning.plans import conclude, pose
from clothkit.planning.reach import (
    WEIGHT,
    Ball,
    Box,
    Breach,
    Limits,
    Region,
    Situation,
    breaches,
    graspable,
    terms_of,
)
from clothkit.planning.trust import NEAR
from clothkit.planning.types import UNKNOWN, Memory
from clothkit.runtime.errors import InputError


def limits_of(
    app: AppConfig,
    *,
    boxes: Sequence[tuple[float, ...]] = (),
    balls: Sequence[tuple[float, ...]] = (),
    keep_out: Sequence[tuple[float, ...]] = (),
    apart: float | None = None,
) -> Limits:
    """Return the limits of the hands, from options or else the settings. Raises InputError for invalid values.

    Each of `boxes` and `keep_out` has the numbers of two corners, each of `balls` those of a centre and a radius.
    """
    regions: list[Region] = [Box(*corners("--reach", box)) for box in boxes]
    regions += [_ball(ball) for ball in balls]
    if len(regions) > 2:
        raise InputError(f"--reach, --reach-ball: expected one for both hands or one for each, found {len(regions)}")
    if not regions and app.reach is not None:
        regions = [_region("reach", app.reach)]
    regions = regions or [_region("hands", region) for region in app.hands]
    zones: list[Region] = [Box(*corners("--keep-out", zone)) for zone in keep_out]
    zones = zones or [_region("keep_out", zone) for zone in app.keep_out]
    apart = app.apart if apart is None else apart
    if not (np.isfinite(apart) and apart >= 0):
        raise InputError(f"--apart: {apart:g}, expected metres, at least 0")
    return Limits(tuple(regions), tuple(zones), apart)


def check_limits(limits: Limits) -> Limits:
    """Return the limits. Raises InputError if they are none that hands can have."""
    for name, regions in (("hands", limits.hands), ("keep_out", limits.keep_out)):
        if isinstance(regions, Box | Ball):
            raise InputError(f"limits: {name}: expected a tuple of regions, found a single one")
        for region in regions:
            if any(np.shape(part) != (3,) for part in (region if isinstance(region, Box) else region[:1])):
                raise InputError(f"limits: {name}: {region}, expected corners and centres of three numbers")
            if np.isnan(np.concatenate([np.ravel(part) for part in region])).any():
                raise InputError(f"limits: {name}: {region} has numbers that are none, expected metres")
            if isinstance(region, Ball) and not region.radius > 0:
                raise InputError(f"limits: {name}: {region}, expected a radius above 0")
            if isinstance(region, Box) and not np.less_equal(region.low, region.high).all():
                raise InputError(f"limits: {name}: {region}, expected the low corner first")
    if len(limits.hands) > 2:
        raise InputError(
            f"limits: hands: expected one region for both hands or one for each, found {len(limits.hands)}"
        )
    if not (np.isfinite(limits.apart) and limits.apart >= 0):
        raise InputError(f"limits: apart: {float(limits.apart):g}, expected metres, at least 0")
    return limits


def reached(
    planner: Planner,
    planned: Planned,
    memory: Memory,
    candidates: Float[np.ndarray, "candidate 2"],
    place: Pose,
    motion: MotionConfig,
    limits: Limits,
    *,
    seed: int,
) -> tuple[Planned, np.ndarray | None]:
    """Return a plan whose hands keep the limits, and the matrix that turned it, if one did.

    `memory` is that before the plan, `candidates` are the state's grasp points, and `place` is where the cloth lies.
    Raises InputError when no such plan does anything.
    """
    forms: list[tuple[Planned, np.ndarray | None]] = []
    breaks: list[list[Breach]] = []
    for fit in _forms(planner, planned, memory.goal[0], limits):
        if not (found := breaches_of(planner, fit[0], place, motion, limits)):
            return fit
        forms, breaks = [*forms, fit], [*breaks, found]
    farthest = max(breaks[0], key=lambda breach: breach.distance)
    told = f"in step {farthest.step} of the plan a hand is {farthest.distance:.3g} m {farthest.limit}"
    points = _grasp_points(planner, planned.state, candidates, place)
    able = graspable(limits, points.metres)
    if not able.any():
        where = ", ".join(f"({x:.2f}, {y:.2f}, {z:.2f})" for x, y, z in points.metres)
        raise InputError(
            f"reach: {told}, and no point that a plan may grasp first is within reach: they are {where} m in the "
            "table's frame"
        )
    nearest = int(np.argmin([sum(breach.distance for breach in found) for found in breaks]))
    best: tuple[Planned, np.ndarray | None] | None = None
    for form, matrix in (forms[number] for number in dict.fromkeys((nearest, 0))):
        aimed = memory if matrix is None else _turned(memory, form, matrix)
        other = _searched(planner, form, aimed, points.uv[able], place, motion, limits, seed=seed)
        if breaches_of(planner, other, place, motion, limits) or bool(np.all(is_null(other.plan))):
            continue
        if best is None or other.expected < best[0].expected:
            best = other._replace(without_limits=planned.expected), matrix
        if best[0].expected <= planned.expected + NEAR:
            break
    if best is None:
        raise InputError(f"reach: {told}, and no plan was found that stays within reach and does anything")
    return best


def _forms(
    planner: Planner, planned: Planned, goal: State, limits: Limits
) -> Iterator[tuple[Planned, np.ndarray | None]]:
    """The plan as it is and, where there are limits, turned and mirrored by the symmetries of the cloth."""
    yield planned, None
    if limits and not planner.system.voxels:
        for matrix in symmetries(planned.state, cloth=planned.cloth)[1:]:
            yield turned_plan(planner, planned, goal, matrix), matrix


def _turned(memory: Memory, form: Planned, matrix: Float[np.ndarray, "2 2"]) -> Memory:
    """The memory before a plan for the turned goal."""
    relative = np.where(memory.relative == UNKNOWN, UNKNOWN, form.relative).astype(memory.relative.dtype)
    return memory._replace(goal=turned_goal(memory.goal[0], matrix)[None], relative=relative)


def breaches_of(planner: Planner, planned: Planned, place: Pose, motion: MotionConfig, limits: Limits) -> list[Breach]:
    """Return the limits that the hands do not keep in a plan for a cloth that lies at `place`."""
    return breaches(limits, [path.points for path in paths_of(planner, planned, place, motion)])


def _searched(
    planner: Planner,
    planned: Planned,
    memory: Memory,
    candidates: Float[np.ndarray, "candidate 2"],
    place: Pose,
    motion: MotionConfig,
    limits: Limits,
    *,
    seed: int,
) -> Planned:
    """The plan that a search finds with the limits in its objective."""
    share = np.linspace(0, 1, motion.waypoints)
    situation = Situation(
        states=np.asarray(planner.representation.equivalents(jnp.asarray(planned.state, jnp.float32))),
        centre=place.centre.astype(np.float32),
        scale=np.float32(place.scale),
        progress=(share**2 * (3 - 2 * share)).astype(np.float32),
        lift=np.float32(motion.highest_lift),
    )
    weight = np.float32(WEIGHT * _range(planner) / (CLOTH_LENGTH * place.scale))
    terms = terms_of(limits, situation, weight=weight, net=planner.best)
    bounded = dataclasses.replace(planner, terms={**planner.terms, **terms})
    length = len(planned.plan)
    points = np.full((planner.grasping.most, 2), np.nan, np.float32)
    points[: len(candidates)] = candidates
    problems = pose(bounded, planned.state[None].astype(np.float32), points[None], memory, length)
    found: Any = bounded.search(problems, jax.random.key(seed).reshape(1), length=length)
    other = planned_of(bounded, conclude(bounded, problems, jax.tree.map(np.asarray, found), points[None]), memory)
    return other._replace(choice=planned.choice)


def _range(planner: Planner) -> float:
    """What the range of a single net's plain loss is, which is not normalised; 1 for several nets."""
    if len(planner.nets) > 1:
        return 1.0
    return float(np.mean(np.subtract(planner.normalisation.high, planner.normalisation.low)))


class _GraspPoints(NamedTuple):
    uv: Float[np.ndarray, "points 2"]
    """In the coordinates of plans."""
    metres: Float[np.ndarray, "points 3"]
    """In the table's frame."""


def _grasp_points(
    planner: Planner, state: State, candidates: Float[np.ndarray, "candidate 2"], place: Pose
) -> _GraspPoints:
    all_points = candidates[np.isfinite(candidates).all(-1)]
    if planner.system.voxels:
        points = np.column_stack([all_points, np.zeros(len(all_points))])
    else:
        points = np.array([np.asarray(to_cartesian(state, uv), float) for uv in all_points]).reshape(-1, 3)
    return _GraspPoints(all_points, place.normalised_to_table(points))


def _ball(ball: tuple[float, ...]) -> Ball:
    if not np.isfinite(ball).all() or ball[3] <= 0:
        found = " ".join(f"{value:g}" for value in ball)
        raise InputError(f"--reach-ball: expected a centre and a radius above 0, found {found}")
    return Ball(ball[:3], ball[3])


def _region(setting: str, region: ReachConfig | BallConfig) -> Region:
    if isinstance(region, BallConfig):
        return Ball(region.centre, region.radius)
    ordered(f"params.yaml: app.{setting}", region.low, region.high)
    return Box(region.low, region.high)
