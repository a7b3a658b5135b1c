"""What a plan file says, against the same in NumPy: places in metres, errors in cloth lengths, how unsure nets are."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from clothkit.app.describe import PlanRequest, covered, describe, expected, frame_of, heights, paths_of, poses_of
from clothkit.app.inputs import Input, Settings
from clothkit.app.plan import summary
from clothkit.app.plan_file import UNLIKELY, Plan, read_plan, write_plan
from clothkit.app.planner import Planned
from clothkit.app.settings import AppConfig
from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.silhouette import centred, iou, silhouette
from clothkit.cloth.symmetry import relabel
from clothkit.cloth.topology import PAPERS_CLOTH, SQUARE
from clothkit.manipulation.candidates import CandidateConfig
from clothkit.observation.observe import observe
from clothkit.observation.pose import Pose
from clothkit.observation.states import MeshState, PointCloud
from clothkit.observation.waypoints import MotionConfig
from clothkit.planning import trust
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.planner import Planner
from clothkit.planning.settings import PlanConfig
from clothkit.planning.systems import system
from clothkit.planning.uncertainty_terms import UncertaintyConfig
from clothkit.planning.voxel_representation import VOXEL
from clothkit.simulation.settings import SimulationConfig
from tests.observation.scenes import motion
from tests.planning import toy

SIDE, SCALE = 0.42, 0.3
CENTRE = np.array([0.1, -0.05])
AXES, ORIGIN = motion(3)
POSE = Pose(AXES, ORIGIN, CENTRE, SCALE)
PLAN = np.array([[-1, -1, 1, -1, 0.1, 0.7], [1, 1, 1, 1, -0.6, -0.4]], np.float32)
SHIFTS = np.array([[0.2, -0.1], [-0.05, 0.4]])
PAIRS = ((0, 1), (0, 2), (1, 2))
TRUST = ErrorMap(
    trust.Signs._fields, np.full(3, 0.002), np.zeros(3), np.ones(3) / 3, np.ones(1), np.linspace(0.5, 1.5, 21)[None]
)


def settings_with(known: ErrorMap | None) -> Settings:
    defaults = AppConfig(), PlanConfig(), toy.WEIGHTS, CandidateConfig(), SimulationConfig(), (0, 1)
    return Settings(*defaults, trust=known)


ENDS = (np.arange(32) % 2 * 2 - 1)[:, None] * np.float32([0, 0, 0.07])
"""Every other row of vertices too high, the others too low."""


def planner(name: str = "b1", nets: int = 2) -> Planner:
    """The second net is the best one, where there are several."""
    usual = dataclasses.replace(toy.NORMALISATION, mu=(0.3,) * 3, sigma=(0.2,) * 3)
    members = (4,) if nets == 1 else (0, 1, 5)[:nets]
    return dataclasses.replace(
        toy.planner(name), members=members, nets=(0.0,) * nets, best=min(nets - 1, 1), normalisation=usual
    )


def planned(nets: int = 2) -> Planned:
    """Two manipulations of the flat cloth; the mean of what two nets expect is a bent cloth, but for `ENDS`.

    A third net expects the bent cloth farther along x.
    """
    first, last = toy.bent() * np.float32([0.9, 1, 9]), toy.bent() + ENDS
    apart = np.linspace(0, 0.2, 32, dtype=np.float32)[:, None, None]
    third = np.float32([0.06, 0, 0])
    means = np.stack([[first, last - apart], [first + 0.01, last + apart], [first + third, last + third]])
    stds = np.stack([np.full((2, 32, 32, 3), std, np.float32) for std in (0.02, 0.05, 0.03)])
    each = [ProbabilisticMesh(*both) for both in zip(means[:nets], stds[:nets], strict=True)]
    apart = [np.asarray(MESH.difference(each[a], each[b])) for a, b in PAIRS if b < nets]
    none = np.zeros((8, 4), np.float32)
    return Planned(
        state=SQUARE.flat(),
        plan=PLAN,
        common=2,
        relative=5,
        means=means[:nets],
        stds=stds[:nets],
        shifts=SHIFTS,
        differences=np.mean(apart, axis=0) if apart else None,
        traces=(none,) * nets,
        loss=1.5,
        expected=0.05,
        expected_no_action=0.11,
    )


def request(goal: np.ndarray, frame: str = "camera") -> PlanRequest:
    mesh = MeshState(SQUARE.flat(), np.zeros(2, np.float32), SCALE)
    seen = observe(mesh, cloth_side=SIDE)
    state = Input("start.obj", mesh, dataclasses.replace(seen, pose=POSE), PAPERS_CLOTH)
    goal_input = Input("goal.obj", mesh, seen, PAPERS_CLOTH)
    return PlanRequest(state, goal_input, goal, None, (SIDE, SIDE), 0.002, 7, frame)


def described(frame: str = "camera", **changes: object) -> Plan:
    plans, of = planner(), planned()._replace(**changes)
    return describe(
        plans, of, paths_of(plans, of, POSE, MotionConfig()), request(np.asarray(relabel(toy.bent(), 3)), frame)
    )


def in_metres(mesh: np.ndarray, moved: np.ndarray, frame: str) -> np.ndarray:
    """A mesh whose centre has moved [normalised], spelled out vertex by vertex."""
    table = mesh.astype(float) * 0.3 + [0.1 + 0.3 * moved[0], -0.05 + 0.3 * moved[1], 0]
    return table if frame == "table" else np.einsum("uvi,ij->uvj", table, AXES) + ORIGIN


def test_hands_are_where_the_best_net_expects_the_cloth() -> None:
    first, second = paths_of(planner(), planned(), POSE, MotionConfig())
    corners = np.array([[-0.7, -0.7, 0], [0.7, -0.7, 0]])
    np.testing.assert_allclose(first.points[:, 0], 0.3 * corners + [*CENTRE, 0], atol=1e-6)
    # Net 1's corner after the first step, about where the cloth has moved to by then.
    corner = planned().means[1, 0, 31, 31].astype(float) + np.array([0.2, -0.1, 0])
    np.testing.assert_allclose(second.points[:, 0], 0.3 * corner[None] + [*CENTRE, 0], atol=1e-6)
    np.testing.assert_allclose(second.points[0, -1, :2] - second.points[0, 0, :2], [-0.18, -0.12], atol=1e-6)


def test_shifts_of_the_centre_add_up() -> None:
    centres = [pose.centre for pose in poses_of(planned(), POSE)]
    np.testing.assert_allclose(centres, [[0.1, -0.05], [0.16, -0.08], [0.145, 0.04]], atol=1e-9)


def test_voxels_are_grasped_at_the_top_of_the_nearest_column() -> None:
    voxels = np.zeros((32, 32, 16), np.float32)
    voxels[20, 9, :4], voxels[20, 9, 4:6], voxels[8, 11, 0], voxels[0, 0] = 0.5, 0.4, 0.9, 0.4
    # Middles of the columns are (0.281, -0.406) and (-0.469, -0.281): halfway between them is (-0.094, -0.344).
    xy = np.array([[0.281, -0.406], [-0.469, -0.281], [-0.075, -0.344], [-0.112, -0.344], [-1, 1]])
    voxel = 0.125 / 16
    np.testing.assert_allclose(heights(voxels, xy), np.array([3.5, 0.5, 3.5, 0.5, 0.5]) * voxel, atol=1e-9)
    np.testing.assert_array_equal(heights(np.full_like(voxels, 0.4), xy), np.zeros(5))


@pytest.mark.parametrize("frame", ["camera", "table"])
def test_places_are_in_metres_in_the_plans_frame(frame: str) -> None:
    plan, of = described(frame), planned()
    assert (plan.frame, plan.side_m, plan.metres_per_normalised, plan.seed) == (frame, 0.42, 0.3, 7)
    assert (plan.state.kind, plan.goal.kind) == ("mesh", "mesh")
    np.testing.assert_allclose(plan.table.axes, AXES if frame == "camera" else np.eye(3))
    np.testing.assert_allclose(plan.table.origin_m, ORIGIN if frame == "camera" else np.zeros(3))
    np.testing.assert_allclose(plan.start.state.vertices_m, in_metres(SQUARE.flat(), np.zeros(2), frame), atol=1e-6)
    assert plan.start.state.sigma_m is None
    moved = np.zeros(2)
    nothing = np.zeros((1, 1, 3))
    for number, step in enumerate(plan.steps):
        grasp = in_metres((SQUARE.flat(), of.means[1, 0])[number], moved, frame)[-number, -number]
        np.testing.assert_allclose(step.hands[0].grasp_m, grasp, atol=1e-6)
        moved = moved + SHIFTS[number]
        np.testing.assert_allclose(step.centre_m, in_metres(nothing, moved, frame)[0, 0], atol=1e-6)
        np.testing.assert_allclose(step.manipulation, PLAN[number])
        assert not step.null
        assert len(step.hands) == 2 - number
        for prediction, means, sigma in zip(step.predictions, of.means, (0.006, 0.015), strict=True):
            np.testing.assert_allclose(prediction.state.vertices_m, in_metres(means[number], moved, frame), atol=1e-6)
            np.testing.assert_allclose(prediction.state.sigma_m, np.full((32, 32, 3), sigma), atol=1e-6)
    # Nets 0 and 1 are 0.01 apart along each axis, then twice 0 to 0.2.
    assert plan.steps[0].disagreement_m == pytest.approx(0.3 * 0.01 * np.sqrt(3), rel=1e-4)
    assert plan.steps[1].disagreement_m == pytest.approx(0.3 * 0.2 * np.sqrt(3), rel=1e-4)


def test_errors_are_those_that_the_agent_found_and_all_else_is_of_the_nets_mean() -> None:
    found = described().expected
    assert (found.error_cloth_lengths, found.error_no_action_cloth_lengths) == (0.05, 0.11)
    assert found.error_m == pytest.approx(0.05 * 0.42)
    assert found.error_no_action_m == pytest.approx(0.11 * 0.42)
    goal, still = (silhouette(centred(mesh)[0]) for mesh in (toy.bent(), SQUARE.flat()))
    assert found.silhouette_iou == pytest.approx(1, abs=0.01)
    assert found.silhouette_iou_no_action == pytest.approx(iou(still, goal), abs=1e-9)
    assert found.silhouette_iou_no_action < 0.95
    assert found.voxel_error is found.voxel_error_no_action is None
    assert found.loss == 1.5
    # Eqs. (13) and (15): six whitened channels.
    exponents = []
    for i in range(2):
        six = []
        for means, stds in zip(planned().means, planned().stds, strict=True):
            mean, spread = means[i].astype(float), np.maximum(means[i].astype(float).std((0, 1)), 0.005)
            six.append(np.concatenate([(mean - mean.mean((0, 1))) / spread, stds[i] / spread], axis=-1))
        exponents.append(5 * ((((six[0] - six[1]) ** 2).mean() - 0.3) / 0.2 - 1.25))
    assert found.epistemic_uncertainty == pytest.approx(np.mean(np.exp(exponents)), rel=2e-3)
    assert found.epistemic_uncertainty > 1


def test_what_the_search_weighed_is_told_and_nothing_else() -> None:
    plans, of = planner(), planned()._replace(model_error=0.03)
    config = dataclasses.replace(plans.settings, uncertainty=UncertaintyConfig(measure="expected"))
    other = dataclasses.replace(plans, settings=config)
    with_u = expected(plans, of._replace(model_error=np.nan), request(toy.bent()))
    with_error = expected(other, of, request(toy.bent()))
    assert with_u["epistemic_uncertainty"] > 1
    assert with_u["prediction_error_m"] is None
    assert with_error["epistemic_uncertainty"] is None
    assert with_error["prediction_error_m"] == pytest.approx(0.03 * 0.42)
    # Without alpha a search weighs none; and what a null manipulation comes to need not be predicted.
    free = dataclasses.replace(plans, weights=plans.weights._replace(alpha=0.0))
    assert expected(free, of, request(toy.bent()))["epistemic_uncertainty"] is None
    idle = of._replace(plan=PLAN * np.float32([1, 1, 1, 1, 0.3, 0.3]))
    assert expected(other, idle, request(toy.bent()))["prediction_error_m"] is None


def test_where_the_estimate_is_poor_is_in_the_plans_frame() -> None:
    std = np.full((32, 32, 3), 0.02, np.float32)
    std[:8, 24:] = 0.06
    plans, of = planner(), planned()
    asked = request(toy.bent())._replace(std=std)
    plan = describe(plans, of, paths_of(plans, of, POSE, MotionConfig()), asked)
    np.testing.assert_allclose(plan.start.state.sigma_m, std * 0.3, atol=1e-6)
    unsure = plan.state.unsure
    assert unsure is not None
    # 0.02 and 0.06 along each axis are 0.025 and 0.074 cloth lengths of 1.4.
    assert (unsure.threshold_m, unsure.share, unsure.part) == (pytest.approx(0.021), 64 / 1024, "corner")
    corner = in_metres(SQUARE.flat(), np.zeros(2), "camera")[:8, 24:].mean((0, 1))
    np.testing.assert_allclose(unsure.centre_m, corner, atol=1e-6)
    (told,) = [notice for notice in plan.notices if "is unsure" in notice]
    where = ", ".join(f"{value:.3f}" for value in corner)
    assert told == f"where 6 % of the cloth lies is unsure (sigma above 21 mm): a corner, around ({where}) m"
    assert told in summary(plan, Path("plan.json"))
    sure = describe(plans, of, paths_of(plans, of, POSE, MotionConfig()), asked._replace(std=np.full_like(std, 0.02)))
    assert sure.state.unsure is not None
    assert (sure.state.unsure.share, sure.state.unsure.part) == (0, None)
    assert "sigma is nowhere above 21 mm" in summary(sure, Path("plan.json"))


@pytest.mark.parametrize(
    ("name", "settings", "says"),
    [
        ("b1", settings_with(TRUST), "known of system main alone, and system b1 planned from a mesh that is taken as"),
        ("b1", settings_with(None), "these nets come without it; the stage calibrate makes it"),
        ("main", settings_with(TRUST), "the measure of uncertainty that its search weighed is not the one"),
        ("b1", None, None),
    ],
)
def test_why_a_plan_has_no_trust(name: str, settings: Settings | None, says: str | None) -> None:
    plans, of = planner(name), planned()
    plan = describe(
        plans, of, paths_of(plans, of, POSE, MotionConfig()), request(toy.bent())._replace(settings=settings)
    )
    told = [notice for notice in plan.notices if "the plan's trust" in notice]
    assert len(told) == (says is not None)
    assert says is None or says in told[0]
    assert plan.expected.trust is None


def test_a_plan_is_warned_of_that_brings_nothing_nearer() -> None:
    good = described()
    assert good.expected.improves
    assert good.warning is None
    worse = described(useless=True, expected=0.12)
    idle = described(plan=PLAN * np.float32([1, 1, 1, 1, 0.3, 0.3]))
    for plan in (worse, idle):
        assert not plan.expected.improves
        assert plan.warning == UNLIKELY


def test_what_a_later_plan_takes_up() -> None:
    memory = described().memory
    assert (memory.common, memory.relative, memory.best, memory.traces_before) == (2, 5, 1, None)
    traces = tuple(np.random.default_rng(k).normal(size=(8, 4)).astype(np.float32) for k in (0, 1))
    np.testing.assert_allclose(described(traces=traces).memory.traces_before, traces, atol=1e-7)
    # One trace alone is something to remember too.
    assert described(traces=(traces[0], 0 * traces[1])).memory.traces_before is not None


def test_one_net_alone_can_not_disagree() -> None:
    plans, of = planner("b2", nets=1), planned(nets=1)
    asked = request(toy.bent())._replace(matrix=np.array([[0.0, -1.0], [1.0, 0.0]]))
    plan = describe(plans, of, paths_of(plans, of, POSE, MotionConfig()), asked)
    assert plan.turned == ((0.0, -1.0), (1.0, 0.0))
    assert plan.expected.epistemic_uncertainty is None
    for step in plan.steps:
        assert step.disagreement_m is None
        assert [prediction.net for prediction in step.predictions] == [4]


@pytest.mark.parametrize("nets", [1, 3])
def test_a_plan_of_any_number_of_nets_is_read_as_it_was_written(tmp_path: Path, nets: int) -> None:
    plans, of = planner(nets=nets), planned(nets=nets)
    plan = describe(plans, of, paths_of(plans, of, POSE, MotionConfig()), request(toy.bent()))
    write_plan(tmp_path / "plan.json", plan)
    assert read_plan(tmp_path / "plan.json") == plan
    assert plan.memory.best == min(nets - 1, 1)
    for number, step in enumerate(plan.steps):
        assert [prediction.net for prediction in step.predictions] == list(plans.members)
        # By hand: the mean over pairs of nets of the mean distance between vertices, 0.3 m long where meshes are 1.
        pairs = [
            np.linalg.norm(of.means[a, number] - of.means[b, number], axis=-1).mean() for a, b in PAIRS if b < nets
        ]
        assert step.disagreement_m == (pytest.approx(0.3 * np.mean(pairs), rel=1e-4) if pairs else None)
    assert (plan.expected.epistemic_uncertainty is None) == (nets == 1)


def test_plans_in_voxels() -> None:
    plans = dataclasses.replace(planner("b1"), system=system("b4"), representation=VOXEL)
    goal, state = np.zeros((2, 32, 32, 16), bool)
    goal[8:16, 8:16, 0] = state[8:24, 8:16, 0] = True
    # The nets put 0.75 and 0.65 where the goal is, and nothing anywhere else.
    means = np.stack([np.where(goal, p, 0).astype(np.float32)[None] for p in (0.75, 0.65)])
    plan = np.array([[-0.4, -0.4, -0.4, -0.4, 0.7, 0.1]], np.float32)
    none = np.zeros((1, 4), np.float32)
    of = Planned(
        state=state,
        plan=plan,
        common=0,
        relative=0,
        means=means,
        stds=None,
        shifts=SHIFTS[:1],
        differences=np.float32([0.1]),
        traces=(none, none),
        loss=0.5,
        expected=0.001,
        expected_no_action=0.004,
    )
    (path,) = paths_of(plans, of, POSE, MotionConfig())
    np.testing.assert_allclose(path.points[0, 0], [0.1 - 0.12, -0.05 - 0.12, 0.3 * 0.5 * 0.125 / 16], atol=1e-6)
    told = expected(plans, of, request(goal))
    assert (told["voxel_error"], told["voxel_error_no_action"]) == (0.001, 0.004)
    assert told["error_m"] is told["error_no_action_cloth_lengths"] is None
    assert told["silhouette_iou"] == 1
    assert told["silhouette_iou_no_action"] == 0.5
    assert told["improves"]
    written = describe(plans, of, [path], request(goal))
    occupancy = np.array(written.steps[0].predictions[0].state.occupancy)
    np.testing.assert_allclose(occupancy, np.where(goal, 0.75, 0), atol=1e-3)
    assert written.start.state.kind == "voxels"
    assert written.steps[0].disagreement_m is None


def test_frames_and_silhouettes() -> None:
    mesh = request(toy.bent()).state
    cloud = dataclasses.replace(mesh, state=PointCloud(np.ones((4, 3))))
    assert frame_of(cloud, "camera") == "camera"
    assert frame_of(cloud, "table") == frame_of(mesh, "camera") == "table"
    voxels = np.zeros((32, 32, 16), np.float32)
    voxels[3, 4, 7], voxels[5, 6, 2] = 0.5, 0.49
    assert np.argwhere(covered(voxels)).tolist() == [[3, 4]]
    moved = SQUARE.flat() + np.float32([0.3, -0.2, 0])
    assert iou(covered(moved), silhouette(SQUARE.flat())) > 0.98
