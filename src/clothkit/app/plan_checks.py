"""Check that the values of a plan file are possible and agree; each check raises ValueError that names the field.

`plan_parts` and `plan_file` declare the fields, and run these checks whenever a plan is made or read.
"""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.manipulation.geometry import release_points, to_cartesian
from clothkit.manipulation.vector import is_null, is_single
from clothkit.observation.pose import Pose
from clothkit.planning.systems import System

if TYPE_CHECKING:
    import clothkit.app.plan_file
    import clothkit.app.plan_parts

FARTHEST = 20.0
"""Limit of the distance of a position from the start's centre [cloth sides]; a plan of three steps reaches less."""

AGREES = 0.01
"""Tolerance of positions [cloth sides]: they are rounded, and computed from float32 values."""

ROUNDING = 1e-4
"""Tolerance of numbers without a unit."""


def check_axes(axes: Sequence[Sequence[float]]) -> None:
    """Check that the rows are the axes of a right-handed frame: unit vectors at right angles."""
    rows = np.array(axes, float)
    if not _orthonormal(rows) or np.linalg.det(rows) < 0:
        raise ValueError(f"axes: expected unit vectors at right angles, z being x cross y, found {rows.tolist()}")


def _orthonormal(rows: Float[np.ndarray, "n n"]) -> bool:
    with np.errstate(over="ignore", invalid="ignore"):
        return bool((np.abs(rows @ rows.T - np.eye(len(rows))) <= ROUNDING).all())


def check_hand(hand: "clothkit.app.plan_parts.Hand") -> None:
    """Check that a hand's waypoints start at the grasp at time 0, end at the release point, and increase in time."""
    times = [point.time_s for point in hand.waypoints]
    late = next((i for i in range(1, len(times)) if times[i] <= times[i - 1]), None)
    if times[0] != 0:
        raise ValueError(f"waypoints.0.time_s: expected 0, when the hand grasps, found {times[0]:g}")
    if late is not None:
        raise ValueError(
            f"waypoints.{late}.time_s: expected later than the {times[late - 1]:g} s before it, found {times[late]:g}"
        )
    for name, place, end in (("grasp_m", 0, hand.grasp_m), ("release_m", -1, hand.release_m)):
        if np.abs(np.subtract(hand.waypoints[place].position_m, end)).max() > 1e-5:
            which = "first" if place == 0 else "last"
            raise ValueError(f"{name}: expected the {which} waypoint, {list(hand.waypoints[place].position_m)}")


def check_step(step: "clothkit.app.plan_parts.Step") -> None:
    """Check that a step has its manipulation's number of hands, at equal times, and predictions of different nets."""
    vector = np.array(step.manipulation, np.float32)
    null, hands = bool(is_null(vector)), 1 if bool(is_single(vector)) else 2
    if step.null != null:
        length = float(np.hypot(*step.manipulation[4:])) / CLOTH_LENGTH
        raise ValueError(
            f"null: expected {str(null).lower()}, by a displacement of {length:.2f} cloth lengths (null below 0.35)"
        )
    if len(step.hands) != (0 if null else hands):
        raise ValueError(f"hands: expected {0 if null else hands}, by its manipulation, found {len(step.hands)}")
    if len({tuple(point.time_s for point in hand.waypoints) for hand in step.hands}) > 1:
        raise ValueError("hands: expected waypoints at the same times, since both hands grasp and release together")
    numbers = [hand.hand for hand in step.hands]
    named = [number for number in numbers if number is not None]
    if named and (len(named) < len(numbers) or len(set(named)) < len(named)):
        raise ValueError("hands: expected different ones of the robot's hands, or null for both")
    nets = [prediction.net for prediction in step.predictions]
    if len(set(nets)) < len(nets):
        raise ValueError(f"predictions: expected different nets, found {', '.join(map(str, nets))}")


def check_unsure(unsure: "clothkit.app.plan_parts.UnsurePart") -> None:
    """Check that the unsure part of an estimate is told if there is one, and only then."""
    for name, value in (("part", unsure.part), ("centre_m", unsure.centre_m)):
        if (value is not None) != (unsure.share > 0):
            raise ValueError(f"{name}: expected {'one' if unsure.share > 0 else 'null'}, by share")
    if unsure.hidden + unsure.unseen > 1 + ROUNDING:
        raise ValueError("unseen: expected at most what hidden leaves of 1")


def check_plan(plan: "clothkit.app.plan_file.Plan", system: System) -> None:
    """Check that a plan's parts agree with one another and with the system that made it."""
    _check_frame(plan)
    _check_turn(plan, system)
    _check_kinds(plan, system)
    _check_places(plan)
    for number in range(len(plan.steps)):
        _check_hands(plan, system, number)
    _check_expectation(plan, system)
    _check_memory(plan, system)
    _check_unsure(plan)


def _check_frame(plan: "clothkit.app.plan_file.Plan") -> None:
    scale = plan.side_m / CLOTH_LENGTH
    if abs(plan.metres_per_normalised / scale - 1) > ROUNDING:
        raise ValueError(
            f"metres_per_normalised: expected side_m / {CLOTH_LENGTH}, {scale:.6g}, found "
            f"{plan.metres_per_normalised:.6g}"
        )
    longer, shorter = plan.sides_m or (plan.side_m, plan.side_m)
    if longer < shorter or abs(longer / plan.side_m - 1) > ROUNDING:
        raise ValueError(f"sides_m: expected side_m, {plan.side_m:g}, and a shorter side, found {longer:g} {shorter:g}")
    if plan.table_in_camera is not None and (plan.frame != "table" or plan.state.kind != "points"):
        raise ValueError("table_in_camera: expected null, unless frame is table and the state's file holds points")
    own = np.abs(np.array(plan.table.axes) - np.eye(3)).max() <= ROUNDING and not np.any(plan.table.origin_m)
    if plan.frame == "table" and not own:
        raise ValueError("table: expected the axes x, y, z and the origin 0 0 0, since frame is table")


def _check_turn(plan: "clothkit.app.plan_file.Plan", system: System) -> None:
    if plan.turned is None:
        return
    if system.voxels:
        raise ValueError(f"turned: expected null, since system {system.name} turns no plans")
    rows = np.array(plan.turned, float)
    if not _orthonormal(rows):
        raise ValueError(f"turned: expected a matrix that turns or mirrors, found {rows.tolist()}")


def _check_kinds(plan: "clothkit.app.plan_file.Plan", system: System) -> None:
    kind = "voxels" if system.voxels else "mesh"
    if system.true_meshes and plan.state.kind != "mesh":
        raise ValueError(f"state.kind: expected mesh, from which system {system.name} plans, found {plan.state.kind}")
    for name, found, _ in _states(plan):
        if found != kind:
            raise ValueError(f"{name}.kind: expected {kind}, in which system {system.name} plans, found {found}")
    first = [prediction.net for prediction in plan.steps[0].predictions]
    if system.single and len(first) > 1:
        raise ValueError(
            f"steps.0.predictions: expected one, since system {system.name} has one net, found {len(first)}"
        )
    for number, step in enumerate(plan.steps):
        nets = [prediction.net for prediction in step.predictions]
        if nets != first:
            expected, found = (", ".join(map(str, names)) for names in (first, nets))
            raise ValueError(f"steps.{number}.predictions: expected nets {expected}, as in steps.0, found {found}")
        apart = step.disagreement_m is not None
        if apart != (len(nets) > 1 and not system.voxels):
            expected = "null" if apart else "a number"
            raise ValueError(
                f"steps.{number}.disagreement_m: expected {expected} for {_counted(nets)} of system {system.name}"
            )


def _counted(nets: list[int]) -> str:
    return "1 net" if len(nets) == 1 else f"{len(nets)} nets"


def _states(plan: "clothkit.app.plan_file.Plan") -> Iterator[tuple[str, str, np.ndarray | None]]:
    """Yield each state's field name, its kind, and the vertices of a mesh in the plan's frame [u v 3; m] or None."""
    named = [("start.state", plan.start.state)]
    for number, step in enumerate(plan.steps):
        named += [(f"steps.{number}.predictions.{k}.state", made.state) for k, made in enumerate(step.predictions)]
    for name, state in named:
        yield name, state.kind, np.array(state.vertices_m, float) if state.kind == "mesh" else None


def _check_places(plan: "clothkit.app.plan_file.Plan") -> None:
    """Check that the cloth's centres are on the table, the first within its mesh, and that no position is far away."""
    pose = plan.pose(plan.start.centre_m)
    centres = [("start.centre_m", plan.start.centre_m)]
    centres += [(f"steps.{number}.centre_m", step.centre_m) for number, step in enumerate(plan.steps)]
    for name, centre in centres:
        above = float(pose.camera_to_table(np.array(centre, float))[2])
        if abs(above) > AGREES * plan.side_m:
            raise ValueError(f"{name}: expected a point on the table, found one {above:.3g} m above it")
        _check_near(plan, pose, name, np.array(centre, float))
    for name, _, vertices in _states(plan):
        if vertices is not None:
            _check_near(plan, pose, f"{name}.vertices_m", vertices)
    for number, step in enumerate(plan.steps):
        for k, hand in enumerate(step.hands):
            points = np.array([point.position_m for point in hand.waypoints], float)
            _check_near(plan, pose, f"steps.{number}.hands.{k}.waypoints", points)
    if plan.start.state.kind == "mesh":
        xy = pose.camera_to_normalised(np.array(plan.start.state.vertices_m, float))[..., :2]
        # The centre is the mean of the silhouette's pixels, and so must be within the bounds of the vertices.
        if xy.min((0, 1)).max() > AGREES * CLOTH_LENGTH or xy.max((0, 1)).min() < -AGREES * CLOTH_LENGTH:
            raise ValueError("start.centre_m: expected the middle of start.state, found a point beside it")


def _check_near(
    plan: "clothkit.app.plan_file.Plan", pose: Pose, name: str, points: Float[np.ndarray, "*points 3"]
) -> None:
    away = float(np.linalg.norm(pose.camera_to_normalised(points), axis=-1).max()) / CLOTH_LENGTH
    if away > FARTHEST:
        raise ValueError(
            f"{name}: expected within {FARTHEST:g} cloth sides of start.centre_m, found {away:.3g} sides of "
            f"{plan.side_m:g} m away"
        )


def _check_hands(plan: "clothkit.app.plan_file.Plan", system: System, number: int) -> None:
    """Check that hands grasp the expected cloth where the manipulation says, and release at the points of eq. (1)."""
    step = plan.steps[number]
    if step.null:
        return
    before = plan.steps[number - 1] if number else None
    pose = plan.pose(plan.start.centre_m if before is None else before.centre_m)
    uv = np.array(step.manipulation[:4], np.float32).reshape(2, 2)
    grasps = pose.camera_to_normalised(np.array([step.hands[0].grasp_m, step.hands[-1].grasp_m], float))
    releases = pose.camera_to_normalised(np.array([step.hands[0].release_m, step.hands[-1].release_m], float))
    best = min(plan.memory.best, len(step.predictions) - 1)
    state = plan.start.state if before is None else before.predictions[best].state
    expected = uv.astype(float)
    if state.kind == "mesh":
        mesh = pose.camera_to_normalised(np.array(state.vertices_m, float)).astype(np.float32)
        expected = np.stack([np.asarray(to_cartesian(mesh, point), float)[:2] for point in uv])
    off = np.linalg.norm(grasps[:, :2] - expected, axis=-1) / CLOTH_LENGTH
    where = np.asarray(release_points(grasps[:, :2], np.array(step.manipulation[4:], float)).points)
    missed = np.linalg.norm(releases[:, :2] - where, axis=-1) / CLOTH_LENGTH
    for name, distances, by in (
        ("grasp_m", off, "the manipulation's grasp point"),
        ("release_m", missed, "the release point of eq. (1) by the manipulation's displacement"),
    ):
        for hand in range(len(step.hands)):
            if distances[hand] > AGREES:
                raise ValueError(
                    f"steps.{number}.hands.{hand}.{name}: expected {by}, found {distances[hand]:.3g} cloth lengths "
                    "beside it"
                )


def _check_expectation(plan: "clothkit.app.plan_file.Plan", system: System) -> None:
    of_meshes = ("error_cloth_lengths", "error_m", "error_no_action_cloth_lengths", "error_no_action_m")
    of_voxels = ("voxel_error", "voxel_error_no_action")
    expected = plan.expected
    for names, present in ((of_meshes, not system.voxels), (of_voxels, system.voxels)):
        for name in names:
            if (getattr(expected, name) is not None) != present:
                wanted = "a number" if present else "null"
                raise ValueError(f"expected.{name}: expected {wanted} for system {system.name}")
    if expected.epistemic_uncertainty is not None and len(plan.steps[0].predictions) == 1:
        raise ValueError("expected.epistemic_uncertainty: expected null, since there is one net")
    if expected.prediction_error_m is not None and (system.voxels or not system.doubts):
        raise ValueError(f"expected.prediction_error_m: expected null for system {system.name}")
    if not system.voxels:
        for name in ("error", "error_no_action"):
            lengths, metres = getattr(expected, f"{name}_cloth_lengths"), getattr(expected, f"{name}_m")
            if abs(lengths * plan.side_m - metres) > ROUNDING * plan.side_m:
                raise ValueError(
                    f"expected.{name}_m: expected {name}_cloth_lengths times side_m, {lengths * plan.side_m:.6g}, "
                    f"found {metres:.6g}"
                )
    error, none = (getattr(expected, name) for name in (of_voxels if system.voxels else of_meshes[::2]))
    possible = {False} if all(step.null for step in plan.steps) else _improvements(plan, error, none)
    if expected.improves not in possible:
        wanted = str(not expected.improves).lower()
        raise ValueError(f"expected.improves: expected {wanted}, by the expected errors and the steps")


def _improvements(plan: "clothkit.app.plan_file.Plan", error: float, none: float) -> set[bool]:
    """Return what `improves` may be by the expected errors with the plan and without any action.

    A turned plan keeps the decision of the plan before it was turned, whose errors were others. At equal errors older
    files say false, newer ones true.
    """
    return {True, False} if plan.turned is not None or error == none else {error < none}


def _check_memory(plan: "clothkit.app.plan_file.Plan", system: System) -> None:
    memory, labels = plan.memory, 1 if system.voxels else 8
    members = [prediction.net for prediction in plan.steps[0].predictions]
    nets = len(members)
    for name, most in (("common", labels - 1), ("relative", labels - 1), ("best", nets - 1)):
        value = getattr(memory, name)
        if value > most:
            raise ValueError(
                f"memory.{name}: expected at most {most} for {_counted(members)} of system {system.name}, found {value}"
            )
    traces = memory.traces_before
    if traces is None:
        return
    if len(traces) != nets or any(len(trace) != labels for trace in traces):
        raise ValueError(
            f"memory.traces_before: expected {nets} of {labels} rows, found {len(traces)} of "
            f"{', '.join(str(len(trace)) for trace in traces)}"
        )
    if any(len({len(row) for row in trace}) > 1 for trace in traces):
        raise ValueError("memory.traces_before: expected rows of one length")


def _check_unsure(plan: "clothkit.app.plan_file.Plan") -> None:
    """Check that what is told of an estimate's standard deviations is what they are."""
    if plan.goal.unsure is not None:
        raise ValueError("goal.unsure: expected null, since start.state alone has standard deviations")
    unsure, start = plan.state.unsure, plan.start.state
    if unsure is None:
        return
    if start.kind != "mesh" or start.sigma_m is None:
        raise ValueError("state.unsure: expected null, since start.state has no standard deviations")
    above = np.linalg.norm(np.array(start.sigma_m, float), axis=-1) > unsure.threshold_m
    if abs(float(above.mean()) - unsure.share) > AGREES:
        raise ValueError(f"state.unsure.share: expected {above.mean():.3f}, by start.state.sigma_m")
    if unsure.centre_m is not None:
        pose = plan.pose(plan.start.centre_m)
        _check_near(plan, pose, "state.unsure.centre_m", np.array(unsure.centre_m, float))
