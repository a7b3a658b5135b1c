"""Cloths before depth cameras: rows, what noise costs in them, and sessions held against those without a camera."""

import dataclasses
from pathlib import Path
from unittest import mock

import jax
import numpy as np
import pandas as pd
import pytest

from clothkit.cloth import voxels
from clothkit.cloth.topology import PAPERS_CLOTH, SQUARE
from clothkit.cloth.voxels import Viewport
from clothkit.dataset.store import SPLITS, Dataset, papers_cloths
from clothkit.episodes.depth_camera import depth_camera
from clothkit.episodes.evaluate import evaluate
from clothkit.episodes.record import Sessions
from clothkit.episodes.sensors import exact_sensor
from clothkit.estimation.agreement import agreement
from clothkit.estimation.estimate import estimate
from clothkit.estimation.refine import RefineConfig
from clothkit.evaluation import camera, camera_planning
from clothkit.evaluation.camera_settings import UNMEASURED, Condition, EvaluateCameraConfig
from clothkit.models import vtm
from clothkit.models.net import Net
from clothkit.models.settings import VtMConfig
from clothkit.observation.picture import Picture, PictureConfig, take
from clothkit.planning.perception import Estimation
from clothkit.runtime.errors import InputError
from tests.episodes.test_sessions import dataset as toy_dataset
from tests.evaluation import camera_rows
from tests.observation.scenes import SMALL, folded
from tests.planning import toy
from tests.tiny import alarms_of

REFINE = RefineConfig(iterations=5)
ALARMS = alarms_of(strangest=10.0)
PICTURE = PictureConfig(camera=SMALL)
SETTINGS = EvaluateCameraConfig(
    conditions=(Condition(name="above"), Condition(name="noisy", tilt=0.3, noise=4.0)),
    picture=PICTURE,
    estimated=2,
    planned=1,
    stored=2,
)


@pytest.fixture(scope="module")
def net() -> Net:
    """A VtM that has learned nothing."""
    return Net(VtMConfig(hidden=16), vtm.initial(VtMConfig(hidden=16), key=jax.random.key(0)))


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    """Two test sequences of folded cloths, the second of two manipulations, and one that is not for evaluation."""
    states = np.stack([SQUARE.flat(), folded(along=0.4), folded(along=0.2, angle=0.5), folded(along=0.0)])
    return Dataset(
        np.stack([states] * 3),
        np.zeros((3, 4, 2), np.float32),
        np.zeros((3, 3, 6), np.float32),
        np.ones((3, 3), np.int8),
        np.array([3, 2, 3], np.int8),
        np.full(3, SPLITS.index("test"), np.int8),
        np.array([True, True, False]),
        *papers_cloths(3),
    )


def test_states_are_seen_and_estimated_under_every_condition(dataset: Dataset, net: Net, tmp_path: Path) -> None:
    found = camera.estimation(dataset, net, SETTINGS, REFINE, ALARMS, work=tmp_path)
    rows = found.rows
    assert rows["condition"].drop_duplicates().tolist() == ["voxels", "above", "noisy"]
    assert rows.groupby("condition").size().tolist() == [5, 5, 5]
    assert rows["seen"].all()
    least, (mesh, seen) = ALARMS.least, (found.arrays[name][0] for name in ("mesh", "voxels"))
    agrees = [agreement(mesh[i], seen[i]) for i in range(2)]
    of_first = rows[(rows["sequence"] == 0) & (rows["state"] == 1) & (rows["condition"] != "voxels")]
    assert all(of_first["alarm"].to_numpy() >= [not each.explains(least) for each in agrees])
    errors = rows.groupby("condition")["voxel_error"].mean()
    assert errors["voxels"] == 0
    assert 0 < errors["above"] < errors["noisy"] < 0.1
    assert (rows.loc[rows["condition"] == "above", "iou"] > 0.9).all()
    # By hand: what is estimated from a picture of the second state of the first sequence.
    truth = dataset.vertices[0, 2]
    seen = take(truth, PictureConfig(camera=SMALL, noise=None)).observation.voxels
    mesh = np.asarray(estimate(net, seen[None], REFINE).mesh[0])
    by_hand = float(camera.errors(mesh[None], truth[None])[0])
    row = rows[(rows["condition"] == "above") & (rows["sequence"] == 0) & (rows["state"] == 2)]
    assert row["error"].item() == pytest.approx(by_hand, rel=1e-4)
    assert row["voxel_error"].item() == (seen != np.asarray(voxels.observe(truth))).mean()
    shapes = {name: array.shape for name, array in found.arrays.items()}
    assert shapes["height"] == (2, 2, SMALL.rows, SMALL.columns)
    assert shapes["voxels"] == (2, 2, 32, 32, 16)
    assert found.arrays["shown"].tolist() == [1, 2]
    measured = found.arrays["height"][:, 0] != UNMEASURED
    # Two layers of cloth on a table: millimetres.
    assert 0.002 < found.arrays["height"][:, 0][measured].max() < 0.03


def test_an_interrupted_estimation_goes_on_with_the_next_condition(dataset: Dataset, net: Net, tmp_path: Path) -> None:
    whole = camera.estimation(dataset, net, SETTINGS, REFINE, ALARMS, work=tmp_path / "whole")
    # Of five states, the second sequence's first one lies as that of the first does, and no figure shows it.
    count = 4

    def stopped(*arguments: object) -> Picture:
        pictures.append(arguments)
        if len(pictures) == count + 2:
            raise KeyboardInterrupt
        return take(*arguments)  # type: ignore[arg-type]

    pictures: list[object] = []
    with mock.patch.object(camera, "take", stopped), pytest.raises(KeyboardInterrupt):
        camera.estimation(dataset, net, SETTINGS, REFINE, ALARMS, work=tmp_path / "broken")
    with mock.patch.object(camera, "take", stopped):
        resumed = camera.estimation(dataset, net, SETTINGS, REFINE, ALARMS, work=tmp_path / "broken")
    assert len(pictures) == count + 2 + count
    pd.testing.assert_frame_equal(resumed.rows, whole.rows)
    for name, array in whole.arrays.items():
        np.testing.assert_array_equal(resumed.arrays[name], array)


def test_what_no_picture_shows_is_missing(dataset: Dataset, net: Net, tmp_path: Path) -> None:
    away = dataclasses.replace(PICTURE, camera=dataclasses.replace(SMALL, aim=(3.0, 0.0)), off=0.0)
    with mock.patch.object(camera, "take", lambda mesh, settings: take(mesh + np.float32([50, 0, 0]), settings)):
        settings = dataclasses.replace(SETTINGS, picture=away)
        rows = camera.estimation(dataset, net, settings, REFINE, ALARMS, work=tmp_path).rows
    before = rows[rows["condition"] != "voxels"]
    assert not before["seen"].any()
    assert before[["voxel_error", "centre_error", "iou", "error"]].isna().all(axis=None)


def test_a_camera_gives_the_voxels_and_shifts_of_its_pictures(net: Net) -> None:
    camera = depth_camera(PICTURE, Estimation(net, REFINE))
    truth = np.stack([folded(), folded(along=0.0)])
    sensed = camera(truth, None)
    pictures: list[Picture] = [take(mesh, PICTURE) for mesh in truth]
    np.testing.assert_array_equal(sensed.shift, [picture.shift for picture in pictures])
    np.testing.assert_array_equal(sensed.observation.voxels, [picture.observation.voxels for picture in pictures])
    # What can't be seen is taken for what was expected, or for flat.
    with mock.patch("clothkit.episodes.depth_camera.take", side_effect=InputError("no cloth")):
        blind, first = camera(truth, truth[::-1]), camera(truth, None)
    assert not blind.shift.any()
    np.testing.assert_array_equal(blind.observation.voxels, voxels.observe(truth[::-1]))
    np.testing.assert_array_equal(first.observation.voxels, [voxels.observe(SQUARE.flat())] * 2)


def test_cloths_that_lie_alike_share_a_picture(net: Net) -> None:
    truth, pictures = np.stack([folded(), folded(along=0.0)]), []
    with mock.patch("clothkit.episodes.depth_camera.take", lambda *given: pictures.append(given) or take(*given)):
        sensed = depth_camera(PICTURE, Estimation(net, REFINE))(truth[[0, 1, 0, 1, 1]], None)
    assert len(pictures) == 2
    of_each = [take(mesh, PICTURE) for mesh in truth[[0, 1, 0, 1, 1]]]
    np.testing.assert_array_equal(sensed.shift, [picture.shift for picture in of_each])
    np.testing.assert_array_equal(sensed.observation.voxels, [picture.observation.voxels for picture in of_each])


def test_sensors_see_as_high_as_the_net_knows(net: Net) -> None:
    perception = Estimation(Net(VtMConfig(hidden=16, viewport=Viewport(height=0.25)), net.params), REFINE)
    truth = folded()[None] * np.array([1, 1, 4], np.float32)
    seen = voxels.observe(truth, viewport=Viewport(height=0.25))
    assert (seen != voxels.observe(truth)).any()
    observation = exact_sensor(perception)(truth, None).observation
    np.testing.assert_array_equal(observation.voxels, seen)
    np.testing.assert_allclose(
        perception(observation, None, PAPERS_CLOTH[None]), estimate(perception.vtm, seen, REFINE).mesh, atol=1e-5
    )
    pictures = []
    with mock.patch("clothkit.episodes.depth_camera.take", lambda mesh, how: pictures.append(how) or take(mesh, how)):
        depth_camera(PICTURE, perception)(truth, None)
    assert [how.cloud.viewport.height for how in pictures] == [0.25]


def test_sessions_before_a_camera_are_held_against_those_without(tmp_path: Path) -> None:
    data = toy_dataset()
    data = dataclasses.replace(data, length=np.ones_like(data.length))
    planner = toy.planner("b1")
    without, _ = evaluate(data, planner, toy.execute, work=tmp_path / "without")
    # Toy cloths fit no camera: a sensor that is as good without one.
    with mock.patch.object(camera_planning, "depth_camera", lambda picture, perception: exact_sensor(perception)):
        tidy = camera_planning.planning(data, planner, toy.execute, without.whole(), SETTINGS, work=tmp_path / "with")
    assert tidy["condition"].tolist() == ["voxels", "above", "noisy"]
    # The same eyes and the same draws: the same outcomes.
    assert tidy["error"].nunique() == 1
    assert (tidy["iou"] > tidy["iou_no_action"]).all()
    assert (tidy["iou"] > 0.9).all()
    assert np.isnan(tidy["iou_seen"].iloc[0])
    two = dataclasses.replace(SETTINGS, planned=2)
    with pytest.raises(InputError, match="1 of them were not planned for"):
        camera_planning.planning(data, planner, toy.execute, first(without.whole()), two, work=tmp_path / "more")


def first(sessions: Sessions) -> Sessions:
    """The first session alone."""
    return Sessions(**{name: values[:1] for name, values in vars(sessions).items()})


def test_conditions_are_compared_task_by_task() -> None:
    found = camera_planning.comparisons(camera_rows.planning())
    assert set(found["system"]) == {"tilted", "noise"}
    assert set(found["against"]) == {"voxels"}
    by = found[found["column"] == "1/all"].set_index("system")["difference"]
    assert by["tilted"] == pytest.approx(0.01)
    assert by["noise"] == pytest.approx(0.02)
