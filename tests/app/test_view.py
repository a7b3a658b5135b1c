"""What the viewer shows, as arrays: no browser is needed to tell whether it is right."""

import dataclasses
import io
import os
import shutil
import subprocess
import sys
import urllib.request
from pathlib import Path
from typing import Literal
from unittest import mock

import numpy as np
import pytest
import trimesh
import zarr

from clothkit.app import named_goals
from clothkit.app.inputs import load_settings, read_input
from clothkit.app.options import observation_options
from clothkit.app.plan_file import UNLIKELY
from clothkit.app.planner import for_one_cloth
from clothkit.app.settings import BallConfig
from clothkit.app.viewer import colours, live
from clothkit.app.viewer.canvas import finer, two_sided
from clothkit.app.viewer.colours import Scale, legend, round_up
from clothkit.app.viewer.live_panel import goal_of_form
from clothkit.app.viewer.recorded import entries, session_of, systems_in
from clothkit.app.viewer.scene import Cloth, View, cubes, hand_paths, scale_of, scene_of, to_show
from clothkit.app.viewer.search_progress import STRAINS_PER_BATCH, OnProgress, Progress, search_in_batches
from clothkit.app.viewer.session import StateEstimate, disagreement, error_of, facts, matched, places
from clothkit.app.viewer.tasks import test_tasks as tasks_in
from clothkit.cloth import voxels
from clothkit.cloth.topology import SQUARE, triangles
from clothkit.episodes import record
from clothkit.manipulation.geometry import release_points, to_cartesian
from clothkit.planning import agent
from clothkit.planning.types import Memory, Observation
from clothkit.runtime.errors import InputError
from tests.app import played
from tests.app.conftest import run
from tests.app.plans import finding
from tests.planning import toy
from tests.planning.test_lengths import finding as finding_each
from tests.toy_dataset import MANIPULATIONS

FORWARD = ("--no-browser", "--port", 0)


def test_paths_lead_from_grasp_to_release_points() -> None:
    mesh, manipulation = played.session().states[0], played.PLAN[0]
    paths = hand_paths(mesh, manipulation)
    grasps = np.stack([np.asarray(to_cartesian(mesh, uv)) for uv in (manipulation[:2], manipulation[2:4])])
    releases = release_points(grasps[:, :2], manipulation[4:]).points
    assert len(paths) == 2
    for path, grasp, release in zip(paths, grasps, releases, strict=True):
        np.testing.assert_allclose(path[0], grasp, atol=1e-5)
        np.testing.assert_allclose(path[-1, :2], release, atol=1e-5)
        reach = np.linalg.norm(release - grasp[:2])
        np.testing.assert_allclose(path[-1, 2] - grasp[2], min(0.2, reach / 2), atol=1e-5)
    assert len(hand_paths(mesh, played.PLAN[1])) == 1
    assert hand_paths(mesh, np.array([1, 1, 1, 1, 0.2, 0.2], np.float32)) == []


def test_paths_in_voxels_start_on_top_of_them() -> None:
    seen = np.asarray(voxels.observe(SQUARE.flat()))
    (path,) = hand_paths(seen, np.array([0.5, 0.5, 0.5, 0.5, -0.8, 0], np.float32))
    np.testing.assert_allclose(path[0, :2], 0.5, atol=1e-6)
    assert 0 < path[0, 2] < 0.01
    np.testing.assert_allclose(path[-1, :2], [-0.3, 0.5], atol=1e-5)
    found = cubes(seen, np.zeros(3, np.float32))
    assert len(found.points) == seen.sum()
    np.testing.assert_allclose(np.abs(found.points[:, :2]).max(), 0.7, atol=0.05)


def test_disagreement_is_palest_where_the_nets_agree() -> None:
    session = played.session()
    step = session.steps[0]
    assert step.plan is not None
    means = step.plan.means.copy()
    # The nets agree on one half of the cloth.
    means[1, :, :16] = means[0, :, :16]
    session = session._replace(steps=(step._replace(plan=step.plan._replace(means=means)), *session.steps[1:]))
    plan = session.steps[0].plan
    assert plan is not None
    apart = disagreement(plan)
    assert apart is not None
    assert (apart[:, :16] == 0).all()
    assert (apart[:, 16:] > 0).any()
    scene = scene_of(session, 0, View("net 0, after 1", "disagreement", "hidden"))
    scale = scale_of(session, "disagreement")
    (cloth,) = scene.cloths
    palest = colours.colours(np.zeros(1, np.float32), scale)[0]
    np.testing.assert_array_equal(cloth.front[:16], np.broadcast_to(palest, (16, 32, 3)))
    far = np.unravel_index(apart[0].argmax(), apart[0].shape)
    assert cloth.front[far].sum() < palest.sum() - 0.1
    np.testing.assert_array_equal(cloth.front, cloth.back)


def test_three_nets_differ_by_the_mean_over_their_pairs_and_one_by_nothing() -> None:
    session = played.session()
    step = session.steps[0]
    assert step.plan is not None
    means = np.stack([*step.plan.means, step.plan.means[0] + np.float32([0.3, 0, 0.4])])
    three = step.plan._replace(members=(0, 3, 8), means=means, sigmas=None)
    by_hand = np.zeros(means.shape[1:4])
    for a, b in ((0, 1), (0, 2), (1, 2)):
        by_hand += np.sqrt(((means[a].astype(float) - means[b]) ** 2).sum(-1)) / 3
    np.testing.assert_allclose(disagreement(three), by_hand, atol=1e-6)
    shown = to_show(session._replace(steps=(step._replace(plan=three), *session.steps[1:])), 0)
    assert [one.name for one in shown[2:]] == [f"net {net}, after {i}" for net in (0, 3, 8) for i in (1, 2)]
    assert {(one.row, one.column) for one in shown[2:]} == {(row, i) for row in (1, 2, 3) for i in (0, 1)}
    one = three._replace(members=(8,), means=means[2:])
    assert disagreement(one) is None
    shown = to_show(session._replace(steps=(step._replace(plan=one), *session.steps[1:])), 0)
    assert [one.name for one in shown[2:]] == ["predicted after 1", "predicted after 2"]


def test_colours_tell_side_height_and_sigma() -> None:
    session = played.session()
    (cloth,) = scene_of(session, 0, View(ghost="hidden")).cloths
    np.testing.assert_allclose(cloth.front[0, 0], colours.FRONT, atol=1e-6)
    np.testing.assert_allclose(cloth.back[0, 0], colours.BACK, atol=1e-6)
    (cloth,) = scene_of(session, 0, View("state", "height", "hidden")).cloths
    height = session.states[0][..., 2]
    light = cloth.front.sum(-1)
    assert light.ravel()[height.argmax()] < light.ravel()[height.argmin()]
    # Nothing is known of the true state, and of an estimate only where it is told.
    for shown in ("state", "estimate"):
        (cloth,) = scene_of(session, 0, View(shown, "sigma", "hidden")).cloths
        np.testing.assert_allclose(cloth.front[3, 3], colours.UNKNOWN, atol=1e-6)
    sigma = np.linspace(0.001, 0.03, 32 * 32 * 3, dtype=np.float32).reshape(32, 32, 3)
    unsure = played.with_sigma(session, sigma)
    (cloth,) = scene_of(unsure, 0, View("estimate", "sigma", "hidden")).cloths
    assert (np.diff(cloth.front.reshape(-1, 3).sum(-1)[::40]) < 0).all()
    assert scale_of(unsure, "sigma").highest >= sigma.max() * 0.99


def test_what_there_is_to_look_at() -> None:
    session = played.session()
    names = [shown.name for shown in to_show(session, 0)]
    assert names == [
        "state",
        "estimate",
        *(f"net {net}, after {i}" for net in (0, 1) for i in (1, 2)),
    ]
    # A prediction shows what is to be done to it next, the last one nothing.
    assert [shown.manipulation is not None for shown in to_show(session, 0)] == [True, True, True, False, True, False]
    assert [shown.name for shown in to_show(session, 2)] == ["outcome"]
    abreast = scene_of(session, 0, View(abreast=True))
    assert len(abreast.cloths) == len(names) + 1
    assert len(set(abreast.middles)) == len(names) + 1
    assert [caption.text for caption in abreast.captions][-1] == "goal"
    assert len(scene_of(session, 0, View()).cloths) == 2
    assert scene_of(session, 0, View()).cloths[-1].opacity < 1
    assert len(scene_of(session, 0, View(ghost="hidden")).cloths) == 1
    assert scene_of(session, 0, View(candidates=False)).dots == ()
    assert scene_of(session, 0, View(paths=False)).paths == ()
    # A name of another step's falls back to the state.
    assert scene_of(session, 2, View("net 1, after 2")).captions[0].text.startswith("outcome")


def test_voxels_are_shown_as_cubes() -> None:
    session = played.session()
    seen = np.asarray(voxels.observe(session.states[0])).astype(np.float32)
    plan = session.steps[0].plan
    assert plan is not None
    means = np.broadcast_to(seen, (2, 2, *seen.shape))
    plan = plan._replace(means=means, sigmas=None, expected=None, expected_no_action=None)
    step = session.steps[0]._replace(estimate=StateEstimate(seen, None, 0.5 * played.CANDIDATES), plan=plan)
    session = session._replace(steps=(step, *session.steps[1:]))
    assert matched(step, session.states[0]) is step
    assert disagreement(plan) is None
    for mode in colours.MODES:
        scene = scene_of(session, 0, View(mode=mode, abreast=True))
        # The state and the goal are meshes.
        assert len(scene.cloths) == 2
        assert sum(dots.cubes for dots in scene.dots) == 5
    assert "expected error" not in facts(session, 0)


def test_facts_say_what_is_expected_and_when_nothing_good_is() -> None:
    session = played.session()
    first, second = (facts(session, at) for at in (0, 1))
    assert UNLIKELY not in first
    assert "expected error **0.020** after the plan, 0.300 if nothing is done" in first
    assert "epistemic uncertainty u = 0.1" in first
    plan = session.steps[0].plan
    assert plan is not None
    for measure, says in (
        ("expected", "the predicted outcome is expected to be off by 0.100"),
        ("support", "surprise of the manipulations 0.1"),
        (None, "uncertainty term 0.1, of a measure that the record does not name"),
    ):
        said = facts(session._replace(steps=(session.steps[0]._replace(plan=plan._replace(measure=measure)),)), 0)
        assert says in said
        assert "u =" not in said
    # Its only manipulation is too short to be one.
    assert UNLIKELY in second
    assert "error **0.000**" in facts(session, 2)
    assert "no plan yet" in facts(session._replace(steps=(session.steps[0]._replace(plan=None),)), 0)


def test_legends_and_scales() -> None:
    assert [round_up(v) for v in (0.0, 0.011, 0.02, 0.3, 0.7)] == [0.001, 0.02, 0.02, 0.5, 1.0]
    assert "front" in legend(Scale("side", 1.0))
    assert "0.1 cloth lengths" in legend(Scale("sigma", 0.14))
    assert "not known" in legend(Scale("disagreement", 0.14))


def test_a_cloth_is_drawn_from_both_sides() -> None:
    mesh = played.session().states[0]
    front, back = (np.broadcast_to(np.array(side, np.float32), mesh.shape) for side in (colours.FRONT, colours.BACK))
    loaded = trimesh.load(io.BytesIO(two_sided(Cloth(mesh, front, back))), file_type="glb")
    a, b = (loaded.geometry[name] for name in ("front", "back"))
    assert not a.visual.material.doubleSided
    np.testing.assert_array_equal(a.faces[:, ::-1], b.faces)
    np.testing.assert_allclose(a.face_normals, -b.face_normals, atol=1e-4)
    assert len(a.faces) == len(triangles((63, 63)))
    np.testing.assert_allclose(finer(mesh, degree=3)[::2, ::2], mesh, atol=1e-5)


@pytest.fixture(scope="module")
def folder(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return played.fill(tmp_path_factory.mktemp("played") / "data", data)


def test_recorded_sessions_are_read_one_by_one(folder: Path) -> None:
    assert systems_in(folder) == ["main"]
    found = entries(folder, "main")
    assert [(e.split, e.sequence, e.start, e.length) for e in found] == [("test", 0, 0, 2), ("test", 1, 1, 1)]
    session = session_of(folder, "main", found[0])
    kept = played.recorded(played.Task(0, 0, 2))
    assert session.length == 2
    assert len(session.states) == 3
    np.testing.assert_array_equal(session.states[1], kept.state[0, 1])
    assert found[0].error == pytest.approx(error_of(session.states[2], session.goal), abs=1e-4)
    assert f"error {found[0].error:.3f}" in found[0].label
    # What came under other labels is under those of the truth, and lies where it lay.
    estimate, plan = session.steps[0]
    assert plan is not None
    np.testing.assert_allclose(estimate.state, kept.state[0, 0], atol=1e-5)
    np.testing.assert_allclose(plan.manipulations, played.PLAN, atol=1e-6)
    np.testing.assert_allclose(plan.means[0], played.after(kept.state[0, 0], played.PLAN), atol=2e-3)
    uv = kept.candidates[0, 0, : len(played.CANDIDATES)]
    np.testing.assert_allclose(places(estimate.state, estimate.candidates), places(kept.estimate[0, 0], uv), atol=1e-5)
    assert plan.uncertainty == 0.25
    np.testing.assert_array_equal(plan.progress, [4, 3, 2, 1.5])
    assert "executed" in plan.note
    assert plan.improves
    assert plan.expected == pytest.approx(0.05)
    off = kept.state[0, 0].astype(float) - kept.goal[0]
    no_action = np.linalg.norm(off - off.mean((0, 1)), axis=-1).mean() / 1.4
    assert plan.expected_no_action == pytest.approx(no_action, rel=1e-4)


def test_a_recorded_plan_that_the_agent_cancelled_is_warned_of(folder: Path) -> None:
    kept = record.load(folder / "evaluation/planning/sessions_main.zarr")
    kept.cancelled[:], kept.null[:], kept.error_otherwise[:] = True, True, 0.2
    with mock.patch.object(record, "load", return_value=kept):
        session = session_of(folder, "main", entries(folder, "main")[0])
    said = facts(session, 0)
    assert UNLIKELY in said
    assert "no improvement was expected (it would have come to 0.200)" in said


def test_nets_of_a_record_have_the_numbers_of_its_members(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "evaluation", tmp_path / "evaluation")
    store = tmp_path / "evaluation/planning/sessions_main.zarr"
    for members, shown in ((None, (0, 1)), ([5, 2], (5, 2))):
        if members is not None:
            zarr.open_group(store).attrs["members"] = members
        plan = session_of(tmp_path, "main", entries(tmp_path, "main")[0]).steps[0].plan
        assert plan is not None
        assert plan.members == shown


def test_a_record_tells_which_measure_its_search_weighed(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "evaluation", tmp_path / "evaluation")
    store = tmp_path / "evaluation/planning/sessions_main.zarr"
    for told, measure in ((None, None), ("expected", "expected"), ("paper", "paper"), ("new", None)):
        if told is not None:
            zarr.open_group(store).attrs["params"] = {"uncertainty": {"measure": told}}
        plan = session_of(tmp_path, "main", entries(tmp_path, "main")[0]).steps[0].plan
        assert plan is not None
        assert (plan.measure, plan.uncertainty) == (measure, 0.25)
    # System b3 minds no uncertainty, and its record has zeros.
    store.rename(store.with_name("sessions_b3.zarr"))
    plan = session_of(tmp_path, "b3", entries(tmp_path, "b3")[0]).steps[0].plan
    assert plan is not None
    assert plan.uncertainty is None


def test_a_named_goal_of_a_live_session_has_the_form_that_is_chosen(folder: Path, tmp_path: Path) -> None:
    settings = load_settings(folder)
    options = observation_options(settings.app, side=None, table=None)
    np.save(tmp_path / "flat.npy", SQUARE.flat())
    start = read_input(str(tmp_path / "flat.npy"), options)
    with mock.patch.object(named_goals, "goal_mesh", return_value=SQUARE.flat()):
        found = goal_of_form(start, "half", 90, True, options, settings)
        plain = goal_of_form(start, "half", None, None, options, settings)
    assert found.variant is not None
    assert plain.variant is not None
    assert (found.variant.turn, found.variant.mirror) == (90, True)
    assert (plain.variant.turn, plain.variant.mirror) == (0, False)
    with pytest.raises(InputError, match="--turn: is for named goals, but the goal is"):
        goal_of_form(start, str(tmp_path / "flat.npy"), 90, None, options, settings)
    assert goal_of_form(start, str(tmp_path / "flat.npy"), None, None, options, settings).variant is None


def test_a_record_that_leads_nowhere_is_told_and_not_left_out(tmp_path: Path) -> None:
    store = tmp_path / "evaluation/planning/sessions_b1.zarr"
    store.parent.mkdir(parents=True)
    store.symlink_to(store.name)
    assert systems_in(tmp_path) == ["b1"]
    with pytest.raises(InputError, match=r"sessions_b1\.zarr: can't be read.*lead in a circle"):
        entries(tmp_path, "b1")
    with pytest.raises(InputError, match=r"sessions_b1\.zarr: can't be read.*lead in a circle"):
        tasks_in(store)
    assert tasks_in(tmp_path / "none") == {}


def test_a_broken_record_is_told(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "evaluation", tmp_path / "evaluation")
    shutil.rmtree(tmp_path / "evaluation/planning/sessions_main.zarr/plan")
    (entry, *_) = entries(tmp_path, "main")
    with pytest.raises(InputError, match=r"sessions_main.zarr: has no array plan"):
        session_of(tmp_path, "main", entry)
    (tmp_path / "evaluation/planning/main.parquet").unlink()
    assert entries(tmp_path, "main")[0].error is None
    with pytest.raises(InputError, match=r"sessions_b1\.zarr: not found"):
        entries(tmp_path, "b1")


def test_a_search_in_lots_tells_how_far_it_is_and_can_be_stopped() -> None:
    planner = for_one_cloth(toy.planner("b1"))
    start, goal, _ = played.session().states
    begun = agent.begin(planner, goal[None], np.array([1]))
    seen, candidates = agent.perceive(planner, Observation(meshes=start[None]), begun)

    def search(on_progress: OnProgress, memory: Memory = begun) -> Progress:
        return search_in_batches(planner, seen[0], candidates[0], memory, seed=0, on_progress=on_progress)

    told: list[Progress] = []
    found = search(lambda progress: not told.append(progress))
    strains = toy.GRADIENT.strains
    assert [progress.done for progress in told] == [*range(0, strains, STRAINS_PER_BATCH), strains]
    assert found.best is not None
    assert (np.diff(found.lowest) <= 0).all()
    assert len(found.lowest) == strains // STRAINS_PER_BATCH * toy.GRADIENT.iterations(1)
    losses = [float(progress.best.loss[0]) for progress in told if progress.best]
    assert losses == sorted(losses, reverse=True)
    reached, before = error_of(found.best.means[0, 0, 0], goal), error_of(start, goal)
    assert reached is not None
    assert before is not None
    assert reached < 0.5 * before
    stopped = search(lambda progress: progress.done == 0)
    assert stopped.done == STRAINS_PER_BATCH
    # A later search of a session starts from what is left of the last plan: here it is found at once.
    rest = np.full_like(begun.rest, np.nan)
    rest[0, 0] = played.PLAN[0]
    later = begun._replace(planned=np.ones(1, bool), relative=np.zeros(1, np.int32), rest=rest)
    first: list[Progress] = []
    search(lambda progress: not first.append(progress) and progress.done == 0, later)
    assert first[-1].done == STRAINS_PER_BATCH
    assert first[-1].lowest[-1] <= stopped.lowest[-1]
    nothing = search(lambda _: False)
    assert nothing.best is None


def under_way(
    folder: Path, monkeypatch: pytest.MonkeyPatch, state: str | None = None, steps: int | Literal["auto"] = 2
) -> live.Live:
    """A live session of the toy world, from its first state or another one, before its first plan."""
    monkeypatch.chdir(folder)  # without params.yaml
    how = observation_options(load_settings(folder).app, side=None, table=None, table_colour=None, box=None)
    start, goal = (
        read_input(file, how) for file in (state or f"{folder}/meshes.zarr:0/0", f"{folder}/meshes.zarr:0/2")
    )
    return live.begin(
        for_one_cloth(toy.planner("b1")), start, goal, steps, title="toy", data=folder, settings=load_settings(folder)
    )


def test_a_live_session_goes_from_plan_to_plan(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = under_way(folder, monkeypatch)
    with pytest.raises(InputError, match="has no plan"):
        live.perform(session)
    with mock.patch.object(live, "execute", lambda *given, **_: toy.execute(*given)):
        for left in (2, 1):
            assert session.left == left
            with finding(recorded_plan()[-left:]):
                session = live.plan(session, seed=0, on_progress=lambda _: True)
            plan = session.session.steps[-1].plan
            assert plan is not None
            assert plan.means.shape == (2, left, 32, 32, 3)
            session = live.perform(session)
            # A toy trace counts the manipulations that were executed.
            assert (session.memory.traces[0] == 3 - left).all()
            np.testing.assert_allclose(session.memory.rest[0, : left - 1], recorded_plan()[-left:][1:])
    shown = session.session
    assert shown.over
    assert len(shown.steps) == 2
    assert "executed, error after it" in facts(shown, 0)
    before, end = (error_of(shown.states[i], shown.goal) for i in (0, 2))
    assert before is not None
    assert end is not None
    assert end < 0.1 * before
    with pytest.raises(InputError, match="is over"):
        live.plan(session, seed=0, on_progress=lambda _: True)


def test_a_live_session_chooses_how_many_manipulations(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = under_way(folder, monkeypatch, steps="auto")
    plans, told = recorded_plan(), list[Progress]()
    assert session.left == 3
    with mock.patch.object(live, "execute", lambda *given, **_: toy.execute(*given)):
        for done in (0, 1):
            longer = {n: np.concatenate([plans[done:], plans[:1], plans[:1]])[:n] for n in (1, 2, 3)}
            with finding_each(longer):
                session = live.plan(session, seed=0, on_progress=lambda now: not told.append(now))
            assert session.plan is not None
            assert len(session.plan.plan) == 2 - done
            session = live.perform(session)
        assert session.left == 1
        with finding_each({1: plans[:1]}):
            session = live.plan(session, seed=0, on_progress=lambda _: True)
    assert session.agent.over
    assert session.left == 0
    assert [progress.strains for progress in told] == [3, 2]
    with pytest.raises(InputError, match="is over"):
        live.plan(session, seed=0, on_progress=lambda _: True)


def test_a_live_plan_keeps_to_the_limits_of_the_settings(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is turned with its goal, which a flat cloth allows, or refused."""
    np.save(tmp_path / "flat.npy", SQUARE.flat())
    session = under_way(folder, monkeypatch, state=str(tmp_path / "flat.npy"))

    def limited(corner: float, radius: float) -> live.Live:
        zone = BallConfig(centre=(corner, corner, 0.0), radius=radius)
        settings = session.agent.settings
        settings = settings._replace(app=dataclasses.replace(settings.app, keep_out=(zone,)))
        return dataclasses.replace(session, agent=dataclasses.replace(session.agent, settings=settings))

    corner = np.array([[-1, -1, -1, -1, 0.7, 0.6], [0, 0, 0, 0, 0.1, 0]], np.float32)
    with finding(corner):
        as_found = live.plan(limited(0.2, 0.1), seed=0, on_progress=lambda _: True)
        turned = live.plan(limited(-0.2, 0.15), seed=0, on_progress=lambda _: True)
        with pytest.raises(InputError, match="inside the ball of radius 5"):
            live.plan(limited(0.2, 5.0), seed=0, on_progress=lambda _: True)
    assert as_found.plan is not None
    assert turned.plan is not None
    np.testing.assert_array_equal(as_found.plan.plan, corner)
    assert (as_found.session.goal == session.session.goal).all()
    shown = turned.session.steps[-1].plan
    assert shown is not None
    np.testing.assert_array_equal(shown.manipulations, turned.plan.plan)
    assert turned.agent.matrix is not None
    np.testing.assert_allclose(turned.plan.plan[0, 4:], turned.agent.matrix @ corner[0, 4:], atol=1e-5)
    np.testing.assert_allclose(turned.session.goal, turned.agent.target)
    assert float(np.abs(turned.session.goal - session.session.goal).max()) > 0.1


def recorded_plan() -> np.ndarray:
    """What leads from state 0 to state 2 of the toy dataset."""
    return MANIPULATIONS[:2]


def test_a_null_manipulation_changes_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    short = recorded_plan().copy()
    short[0, 4:] = 0.1
    with finding(short):
        planned = live.plan(under_way(folder, monkeypatch), seed=0, on_progress=lambda _: True)
    done = live.perform(planned)
    np.testing.assert_array_equal(done.session.states[1], done.session.states[0])
    assert (done.memory.traces[0] == 0).all()
    assert "too short" in facts(done.session, 0)


def test_tasks_are_those_of_the_test_split(folder: Path, tmp_path: Path) -> None:
    found = tasks_in(folder / "meshes.zarr")
    assert len(found) == 12
    files = found["sequence 1, state 1 to 3"]
    assert (files.state, files.goal, files.steps) == (f"{folder}/meshes.zarr:1/1", f"{folder}/meshes.zarr:1/3", 2)
    assert tasks_in(tmp_path / "meshes.zarr") == {}
    (tmp_path / "meshes.zarr").mkdir()
    with pytest.raises(InputError, match="can't be read as a zarr store"):
        tasks_in(tmp_path / "meshes.zarr")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--state", "a.obj"), "--goal: missing"),
        (("--goal", "a.obj"), "--state: missing"),
        (("--data", "nowhere"), "nowhere: not found"),
        (("--state", "none.obj", "--goal", "a.obj"), "none.obj: not found"),
        (("--box", 5, 5, 5, 1, 1, 1), "--box"),
        (("--host", "192.0.2.1"), "--host: 192.0.2.1 is no address of this machine"),
        (("--host", "no such host"), "--host: 'no such host' is unknown"),
        (("--data", "."), ".: holds nothing to show, expected recorded sessions"),
        (("--state", "a.obj", "--goal", "a.obj", "--data", "."), "nets/pemd/0: not found, system main plans with it"),
    ],
)
def test_bad_input_is_told_in_one_sentence(here: Path, arguments: tuple[object, ...], says: str) -> None:
    result = run("view", *FORWARD, *arguments)
    assert result.exit_code == 1
    (sentence,) = result.stderr.splitlines()
    assert sentence.startswith("view: ")
    assert says in sentence


def test_the_command_serves_a_page_until_it_is_interrupted(folder: Path) -> None:
    arguments = [sys.executable, "-m", "clothkit", "view", *(str(argument) for argument in FORWARD)]
    with subprocess.Popen(
        arguments,
        cwd=folder.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        address = process.stdout.readline().split()[0]
        with urllib.request.urlopen(address, timeout=30) as answer:
            assert b"<html" in answer.read(2000)
        # Not SIGINT, which is ignored by whatever a shell has put in the background, tests among it.
        process.terminate()
        try:
            assert process.wait(timeout=60) == 0
        finally:
            process.kill()
        assert "Traceback" not in process.stderr.read()
