"""Convert a plan that was found to the content of a plan file: in metres, in a frame, with the expected outcome."""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from clothkit.app.advice import Signs, is_flat, told_of, warning_of
from clothkit.app.agreement import EstimateAgreement
from clothkit.app.inputs import Input, Settings
from clothkit.app.plan_file import Plan, plan_of, rounded
from clothkit.app.plan_parts import UnsurePart
from clothkit.app.planner import Planned, State, trusted_of, usage_of
from clothkit.app.uncertainty import epistemic_uncertainty
from clothkit.app.unsure import THRESHOLD, unsure_part
from clothkit.cloth.mesh import distance
from clothkit.cloth.silhouette import centred, iou, silhouette
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.cloth.voxels import HEIGHT, RESOLUTION
from clothkit.manipulation.vector import grasp_points, is_null
from clothkit.models.ensemble import pairs
from clothkit.observation.pose import Pose
from clothkit.observation.waypoints import HandPaths, MotionConfig, hand_paths, paths_from
from clothkit.planning.planner import Planner
from clothkit.planning.reach import Box, Limits, Region

_MICROMETRES = 6
_FAR = 100.0  # metres: farther than any hand reaches
_SURELY = 0.5  # probability from which a voxel counts as cloth

Frame = Literal["camera", "table"]


class PlanRequest(NamedTuple):
    """The inputs of one planning request."""

    state: Input
    goal: Input
    target: State
    """The goal of the search, in the system's representation; turned if the plan was turned."""
    matrix: Float[np.ndarray, "2 2"] | None
    """The matrix that the goal was turned or mirrored by; None: it was not."""
    sides: tuple[float, float]
    """Sides of the flat cloth, the longer one first [m]."""
    thickness: float
    """Distance of the middles of two layers that touch [m]."""
    seed: int
    frame: Frame
    agreements: tuple[EstimateAgreement | None, EstimateAgreement | None] = (None, None)
    """Agreement of the estimates of state and goal with their observations; None: not estimated."""
    settings: Settings | None = None
    """What is known of the nets: how far plans can be trusted."""
    limits: Limits = Limits()
    """What the hands keep to."""
    hands: Sequence[tuple[int, ...] | None] = ()
    """Which of the robot's hands follow the paths of each step; None, or no entry: any."""
    std: Float[np.ndarray, "u v 3"] | None = None
    """The standard deviations of an estimated state, in its labels [normalised]; None: not estimated."""

    @property
    def side(self) -> float:
        """The longer side [m]."""
        return self.sides[0]


def frame_of(source: Input, wanted: Frame) -> Frame:
    """Return the frame of a plan's positions: `wanted` for point clouds; meshes and voxels are in the table's frame."""
    return wanted if source.kind == "points" else "table"


def paths_of(planner: Planner, planned: Planned, pose: Pose, motion: MotionConfig) -> list[HandPaths]:
    """Return the timed paths of the hands in each step, in the table's frame.

    In the first step the hands grasp the state, in later steps the best net's prediction of it.
    """
    means = planned.means[planner.best]
    places = poses_of(planned, pose)
    states = [planned.state, *means[:-1]]
    if not planner.system.voxels:
        return [
            hand_paths(m, mesh.astype(np.float32), place, motion)
            for m, mesh, place in zip(planned.plan, states, places, strict=False)
        ]
    paths = []
    for manipulation, voxels, place in zip(planned.plan, states, places, strict=False):
        xy = np.stack([np.asarray(point, float) for point in grasp_points(manipulation)])
        grasps = np.column_stack([xy, heights(voxels, xy)])
        paths.append(paths_from(grasps, manipulation, place, motion))
    return paths


def poses_of(planned: Planned, pose: Pose) -> list[Pose]:
    """Return the expected pose of the cloth before the first step and after each step."""
    return [pose, *(pose.moved(shift) for shift in np.cumsum(planned.shifts, axis=0))]


def heights(voxels: State, xy: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, " points"]:
    """Return the cloth's height in the occupied column nearest to each point [normalised]; 0 if none is occupied."""
    columns = np.argwhere((voxels >= _SURELY).any(-1))
    if not len(columns):
        return np.zeros(len(xy))
    middles = (columns + 0.5) * (2 / RESOLUTION[0]) - 1
    nearest = columns[((xy[:, None] - middles) ** 2).sum(-1).argmin(1)]
    top = (voxels[nearest[:, 0], nearest[:, 1]] >= _SURELY).sum(-1)
    return (top - 0.5) * (HEIGHT / RESOLUTION[2])


def describe(planner: Planner, planned: Planned, paths: list[HandPaths], request: PlanRequest) -> Plan:
    """Return the content of the plan file. `paths` are in the table's frame.

    Raises InputError if the plan fails the checks of plan files.
    """
    real = request.state.pose
    # In the table's frame, the conversion from table to camera must change nothing.
    pose = real if request.frame == "camera" else Pose(np.eye(3), np.zeros(3), real.centre, real.scale)
    poses = poses_of(planned, pose)
    expectation = expected(planner, planned, request)
    unsure = unsure_of(request.state, planned.state, request.std, pose)
    warning = warning_of(expectation["improves"], expectation["outcome_error_m"], expectation["error_no_action_m"])
    signs = Signs(
        *request.agreements,
        unsure,
        trust=expectation["trust"],
        warning=warning,
        away=expectation["error_no_action_cloth_lengths"],
        steps=len(planned.plan),
        flat=is_flat(planned.state, request.state.cloth),
        named=None if request.goal.variant is None else request.goal.file,
    )
    of_points = request.frame == "table" and request.state.kind == "points"
    content = {
        "format": "clothkit plan",
        "version": 2,
        "system": planner.system.name,
        "seed": request.seed,
        "frame": request.frame,
        "state": _source(planner, request.state, request.agreements[0], unsure),
        "goal": _source(planner, request.goal, request.agreements[1], goal=True),
        "turned": None if request.matrix is None else rounded(request.matrix, 9),
        "side_m": request.side,
        "sides_m": None if request.sides[0] == request.sides[1] else request.sides,
        "thickness_m": request.thickness,
        "metres_per_normalised": pose.scale,
        "table": _table(pose),
        "table_in_camera": _table(real) if of_points else None,
        "limits": _limits(request.limits),
        "start": {"state": _state(planned.state, request.std, pose), "centre_m": _centre(pose)},
        "steps": [
            _step(planner, planned, i, path, poses[i + 1], request.hands[i] if request.hands else None)
            for i, path in enumerate(paths)
        ],
        "expected": expectation,
        "warning": warning,
        "notices": [*notices(request), *told_of(signs), *_without_trust(planner, request, expectation)],
        "memory": {
            "common": planned.common,
            "relative": planned.relative,
            "best": planner.best,
            "traces_before": [[rounded(label, 7) for label in trace] for trace in planned.traces]
            if any(trace.any() for trace in planned.traces)
            else None,
        },
    }
    return plan_of(content)


def _table(pose: Pose) -> dict[str, Any]:
    return {"axes": pose.rotation.tolist(), "origin_m": pose.origin.tolist()}


def _limits(limits: Limits) -> dict[str, Any] | None:
    if not limits:
        return None
    hands, keep_out = ([_region(region) for region in regions] for regions in (limits.hands, limits.keep_out))
    return {"hands": hands, "keep_out": keep_out, "apart_m": float(limits.apart)}


def _region(region: Region) -> dict[str, Any]:
    if isinstance(region, Box):
        return {"low_m": _finite(region.low), "high_m": _finite(region.high)}
    return {"centre_m": _finite(region.centre), "radius_m": min(float(region.radius), _FAR)}


def _finite(values: Any) -> list[float]:
    """Coordinates as JSON can hold them: a box may be open to a side."""
    return [float(value) for value in np.clip(np.asarray(values, float), -_FAR, _FAR)]


def notices(request: PlanRequest) -> list[str]:
    """Return sentences on how state and goal were read and observed, and on estimates that do not explain them."""
    sentences = [*request.state.notices, *request.goal.notices]
    sentences += [found.sentence for found in request.agreements if found is not None and not found.reliable]
    # State and goal may be one file.
    return list(dict.fromkeys(sentences))


def expected(planner: Planner, planned: Planned, request: PlanRequest) -> dict[str, Any]:
    """Return the fields of `plan_parts.Expectation`, from the mean of the nets' predictions after the last step.

    Errors are those by which the agent decides whether a plan is useless: in the labelling that the search found.
    """
    # What a null manipulation comes to is known better than nets predict it.
    outcome = planned.state if bool(np.all(is_null(planned.plan))) else np.mean(planned.means[:, -1], axis=0)
    error = planned.prediction_error
    fields: dict[str, Any] = {"prediction_error_m": None if error is None else error * request.side}
    fields |= dict.fromkeys(("error_cloth_lengths", "error_m", "error_no_action_cloth_lengths", "error_no_action_m"))
    fields |= dict.fromkeys(("voxel_error", "voxel_error_no_action"))
    for name, state, error in (
        ("", outcome, planned.expected),
        ("_no_action", planned.state, planned.expected_no_action),
    ):
        if planner.system.voxels:
            fields[f"voxel_error{name}"] = error
        else:
            fields[f"error{name}_cloth_lengths"], fields[f"error{name}_m"] = error, error * request.side
        fields[f"silhouette_iou{name}"] = iou(covered(state), covered(request.target))
    if not planner.system.voxels and np.isfinite(planned.without_limits):
        fields["error_without_limits_m"] = planned.without_limits * request.side
    told = None if request.settings is None else trusted_of(planned, request.settings, planner.system)
    outcome_error = ("outcome_error_m", "outcome_error_low_m", "outcome_error_high_m")
    fields |= dict.fromkeys((*outcome_error, "trust"))
    if told is not None:
        lengths = (told.error, told.low, told.high)
        fields |= {name: float(value[0]) * request.side for name, value in zip(outcome_error, lengths, strict=True)}
        fields["trust"] = float(told.trust[0])
    return {
        **fields,
        "epistemic_uncertainty": epistemic_uncertainty(planner, planned),
        "loss": planned.loss,
        "improves": planned.improves,
    }


def covered(state: State) -> np.ndarray:
    """Return the mask of the silhouette of a mesh, centred, or of the voxel columns that hold cloth."""
    if state.shape == RESOLUTION:
        return np.asarray((state >= _SURELY).any(-1))
    return silhouette(centred(state.astype(np.float32))[0])


def unsure_of(source: Input, state: State, std: Float[np.ndarray, "u v 3"] | None, pose: Pose) -> UnsurePart | None:
    """Return where the estimate of a state is poor, in metres in the frame of `pose`; None: not estimated."""
    if std is None:
        return None
    found, threshold = unsure_part(state, std, source.observation.voxels), THRESHOLD * CLOTH_LENGTH * pose.scale
    if found is None:
        return UnsurePart(threshold_m=threshold, share=0, part=None, centre_m=None, hidden=0, unseen=0)
    return UnsurePart(
        threshold_m=threshold,
        share=found.share,
        part=found.part,
        centre_m=tuple(rounded(pose.normalised_to_camera(found.centre), _MICROMETRES)),
        hidden=found.hidden,
        unseen=found.unseen,
    )


def _without_trust(planner: Planner, request: PlanRequest, expectation: dict[str, Any]) -> list[str]:
    """Return why nothing is known of how often such plans came true, if that is so."""
    if request.settings is None or expectation["trust"] is not None:
        return []
    system = planner.system
    if request.settings.trust is None:
        why = "these nets come without it; the stage calibrate makes it"
    elif system.name != "main":
        of = "a mesh that is taken as it is" if system.true_meshes else "this state"
        why = (
            f"it is known of system main alone, and system {system.name} planned from {of}; a plan from a point cloud "
            "of the cloth, or with --system main, has it"
        )
    else:
        why = "the measure of uncertainty that its search weighed is not the one that it was calibrated with"
    return [f"the plan's trust, how often such plans came true, is not known: {why}"]


def _source(
    planner: Planner,
    source: Input,
    found: EstimateAgreement | None,
    unsure: UnsurePart | None = None,
    *,
    goal: bool = False,
) -> dict[str, Any]:
    agreement = None
    if found is not None:
        agreement = {
            "silhouette_iou": round(found.silhouette_iou, 4),
            "height_iou": round(found.height_iou, 4),
            "explains": found.explains,
            "strangeness": None if found.strangeness is None else round(found.strangeness, 4),
            "known": found.known,
        }
    usage, form = usage_of(planner.system, source, goal=goal), source.variant
    named = None if form is None else {"turn_deg": form.turn, "mirror": form.mirror, "angle_rad": form.angle}
    return {
        "file": source.file,
        "kind": source.kind,
        "taken": usage,
        "agreement": agreement,
        "unsure": unsure,
        "named": named,
    }


def _step(
    planner: Planner, planned: Planned, i: int, path: HandPaths, after: Pose, numbers: tuple[int, ...] | None
) -> dict[str, Any]:
    means = planned.means[:, i]
    stds = [None] * len(means) if planned.stds is None else planned.stds[:, i]
    apart = None
    if len(means) > 1 and not planner.system.voxels:
        apart = float(np.mean([float(distance(a, b)) for a, b in pairs(list(means))])) * CLOTH_LENGTH * after.scale
    points = after.table_to_camera(path.points)
    hands = [
        {
            "grasp_m": rounded(hand[0], _MICROMETRES),
            "release_m": rounded(hand[-1], _MICROMETRES),
            "waypoints": [
                {"time_s": round(float(time), 4), "position_m": rounded(point, _MICROMETRES)}
                for time, point in zip(path.times, hand, strict=True)
            ],
            "hand": None if numbers is None else numbers[k],
        }
        for k, hand in enumerate(points)
    ]
    return {
        "manipulation": planned.plan[i].astype(float).tolist(),
        "null": bool(is_null(planned.plan[i])),
        "hands": hands,
        "predictions": [
            {"net": net, "state": _state(mean, std, after)}
            for net, mean, std in zip(planner.members, means, stds, strict=True)
        ],
        "centre_m": _centre(after),
        "disagreement_m": apart,
    }


def _state(mean: State, std: np.ndarray | None, pose: Pose) -> dict[str, Any]:
    if mean.shape == RESOLUTION:
        return {"kind": "voxels", "occupancy": rounded(mean, 3)}
    return {
        "kind": "mesh",
        "vertices_m": rounded(pose.normalised_to_camera(mean.astype(float)), _MICROMETRES),
        "sigma_m": None if std is None else rounded(std * pose.scale, _MICROMETRES),
    }


def _centre(pose: Pose) -> Any:
    return rounded(pose.table_to_camera(np.append(pose.centre, 0.0)), 7)
