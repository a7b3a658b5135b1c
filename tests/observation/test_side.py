"""Which side of a table is up: every rigid motion of a cloud gives one observation, and none gives its mirror image."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clothkit.observation.cloud import Observation, observe_cloud
from clothkit.observation.plane import Plane, plane_of
from clothkit.observation.side import Heights, Stated, evidence, heights_of, oriented
from clothkit.observation.states import PointCloud
from clothkit.runtime.errors import InputError
from tests.observation.scenes import motion

SIDE = 0.4
LEVEL = Plane(np.array([0.0, 0.0, 1.0]), 0.0)


def towel(*, folded: bool = True, thickness: float = 0.002, noise: float = 0.0005) -> PointCloud:
    """A towel of which a corner is folded over an oblique line, and its table at z = 0, in the table's frame."""
    random = np.random.default_rng(0)
    axis = np.arange(-SIDE / 2, SIDE / 2, 0.004)
    x, y = (part.ravel() for part in np.meshgrid(axis, axis))
    cloth = np.column_stack([x, y, np.full(x.size, thickness)])
    if folded:
        normal = np.array([1, 0.4]) / np.hypot(1, 0.4)
        past = cloth[:, :2] @ normal - 0.11
        cloth[past > 0, :2] -= 2 * past[past > 0, None] * normal
        cloth[past > 0, 2] = 3 * thickness
    axis = np.arange(-0.5, 0.5, 0.008)
    x, y = (part.ravel() for part in np.meshgrid(axis, axis))
    table = np.column_stack([x, y, np.zeros(x.size)])
    table = table[np.abs(table[:, :2]).max(1) > SIDE / 2 + 0.01]
    points = np.concatenate([cloth, table])
    mask = np.arange(len(points)) < len(cloth)
    return PointCloud(points + random.normal(0, noise, points.shape), cloth=mask)


TOWEL = towel()
FLAT = towel(folded=False, thickness=0.0)
ABOVE = np.array([0.1, -0.2, 0.9])


def moved(cloud: PointCloud, seed: int) -> tuple[PointCloud, np.ndarray, np.ndarray]:
    """A cloud in another frame, and the motion that led there."""
    rotation, shift = motion(seed)
    # The origin shall be on one side or the other, and not in the table.
    shift += rotation[:, 2] * (np.sign(rotation[:, 2] @ shift) or 1.0) * 0.05
    viewpoint = None if cloud.viewpoint is None else rotation @ cloud.viewpoint + shift
    return PointCloud(cloud.points @ rotation.T + shift, cloth=cloud.cloth, viewpoint=viewpoint), rotation, shift


def same(seen: Observation, plain: Observation, rotation: np.ndarray, shift: np.ndarray) -> None:
    """Whether two observations are one, the second moved."""
    np.testing.assert_allclose(seen.pose.rotation[2], rotation @ plain.pose.rotation[2], atol=1e-4)
    back = seen.pose.normalised_to_camera(seen.points.astype(float))
    expected = plain.pose.normalised_to_camera(plain.points.astype(float)) @ rotation.T + shift
    np.testing.assert_allclose(back, expected, atol=3e-4)


PLAIN = observe_cloud(dataclasses.replace(TOWEL, viewpoint=ABOVE), cloth_side=SIDE)


@settings(max_examples=6)
@given(st.integers(0, 10_000), st.sampled_from(["viewpoint", "stated viewpoint", "up", "table"]))
def test_any_rigid_motion_gives_the_same_observation(seed: int, by: str) -> None:
    cloud, rotation, shift = moved(dataclasses.replace(TOWEL, viewpoint=ABOVE), seed)
    stated, table = Stated(), None
    if by != "viewpoint":
        cloud = dataclasses.replace(cloud, viewpoint=None)
    if by == "stated viewpoint":
        x, y, z = (rotation @ ABOVE + shift).tolist()
        stated = Stated(viewpoint=(x, y, z))
    if by == "up":
        # Not quite, and of any length.
        x, y, z = (rotation @ np.array([0.3, -0.1, 2.0])).tolist()
        stated = Stated(up=(x, y, z))
    if by == "table":
        plane = PLAIN.pose.rotation[2]
        normal = rotation @ plane
        table = Plane(normal, float(plane @ PLAIN.pose.origin + normal @ shift))
    same(observe_cloud(cloud, cloth_side=SIDE, stated=stated, table=table), PLAIN, rotation, shift)


@settings(max_examples=8)
@given(st.integers(0, 10_000), st.booleans())
def test_mirror_images_never_come_out(seed: int, flat: bool) -> None:
    """Nothing is stated: the cloth is seen the right way up, or refused with what to do about it."""
    cloud, rotation, shift = moved(FLAT if flat else TOWEL, seed)
    origin_is_above = -rotation[:, 2] @ shift > 0
    if flat or not origin_is_above:
        with pytest.raises(InputError, match="--up"):
            observe_cloud(cloud, cloth_side=SIDE)
    else:
        assert observe_cloud(cloud, cloth_side=SIDE).pose.rotation[2] @ rotation[:, 2] > 0.99


@pytest.mark.parametrize(
    "mistaken",
    [
        {"stated": Stated(up=(0.0, 0.0, -1.0))},
        {"stated": Stated(viewpoint=(0.0, 0.0, -1.0))},
        {"table": plane_of((0.0, 0.0, -1.0, 0.0))},
        {"cloud": dataclasses.replace(TOWEL, viewpoint=-ABOVE)},
        {"cloud": dataclasses.replace(TOWEL, points=TOWEL.points * [1, 1, -1], viewpoint=ABOVE)},
        {"cloud": dataclasses.replace(TOWEL, points=TOWEL.points + np.array([0.5, 0, 0.72]))},
    ],
)
def test_what_contradicts_the_cloth_is_refused(mistaken: dict) -> None:  # type: ignore[type-arg]
    cloud = mistaken.pop("cloud", TOWEL)
    with pytest.raises(InputError, match=r"^towel: the cloth lies .*--up") as raised:
        observe_cloud(cloud, cloth_side=SIDE, name="towel", **mistaken)
    assert "\n" not in str(raised.value)


def test_statements_that_contradict_one_another_are_refused_but_for_up_which_wins() -> None:
    cloud = dataclasses.replace(TOWEL, viewpoint=ABOVE)
    upside_down = plane_of((0.0, 0.0, -1.0, 0.0))
    with pytest.raises(InputError, match=r"the viewpoint is 0\.9 m below the table, whose normal .*--up"):
        observe_cloud(cloud, cloth_side=SIDE, table=upside_down)
    seen = observe_cloud(cloud, cloth_side=SIDE, table=upside_down, stated=Stated(up=(0.0, 0.0, 1.0)))
    np.testing.assert_allclose(seen.pose.rotation[2], [0, 0, 1])
    with pytest.raises(InputError, match="up leans 80 degrees from the table's normal"):
        observe_cloud(cloud, cloth_side=SIDE, stated=Stated(up=(1.0, 0.0, np.tan(np.radians(10)))))
    with pytest.raises(InputError, match="the viewpoint lies in the table"):
        observe_cloud(cloud, cloth_side=SIDE, stated=Stated(viewpoint=(0.5, 0.2, 0.01)))


def test_a_flat_cloth_needs_to_be_told() -> None:
    with pytest.raises(InputError, match=r"too flat to tell which side of the table is up; say it \(--up"):
        observe_cloud(dataclasses.replace(FLAT, points=FLAT.points - [0, 0, 0.8]), cloth_side=SIDE)
    with pytest.raises(InputError, match="the origin lies in the table and the cloth is too flat"):
        observe_cloud(FLAT, cloth_side=SIDE)
    below = dataclasses.replace(FLAT, points=FLAT.points + np.array([0, 0, 0.72]))
    alone = PointCloud(below.points[below.cloth])
    # A robot's base below its table, or a normal that points away from the camera: a flat cloth doesn't tell.
    with pytest.raises(InputError, match="normal points away from the origin"):
        observe_cloud(alone, cloth_side=SIDE, table=plane_of((0.0, 0.0, 1.0, 0.72)))
    for stated in (Stated(up=(0.0, 0.0, 1.0)), Stated(viewpoint=(0.0, 0.0, 2.0))):
        seen = observe_cloud(alone, cloth_side=SIDE, table=plane_of((0.0, 0.0, 1.0, 0.72)), stated=stated)
        np.testing.assert_allclose(seen.pose.rotation[2], [0, 0, 1])
    # A folded one does, and an origin in the table decides nothing.
    for shift in (0.0, 0.72):
        points = TOWEL.points[TOWEL.cloth] + [0, 0, shift]
        seen = observe_cloud(PointCloud(points), cloth_side=SIDE, table=plane_of((0.0, 0.0, 1.0, shift)))
        np.testing.assert_allclose(seen.pose.rotation[2], [0, 0, 1])
    np.testing.assert_allclose(observe_cloud(TOWEL, cloth_side=SIDE).pose.rotation[2], [0, 0, 1], atol=1e-3)


def test_evidence_is_what_noise_and_an_uneven_table_do_not_explain() -> None:
    folded = Heights(low=0.001, middle=0.001, high=0.005, deviation=0.0005)
    assert evidence(folded, sure=True) == "above"
    assert evidence(folded.flipped(), sure=True) == "below"
    # Three deviations of the table's patches.
    assert evidence(folded._replace(deviation=0.002), sure=True) == "unknown"
    assert evidence(folded._replace(deviation=0.0021), sure=False) == "unknown"
    assert evidence(folded._replace(deviation=0.0019), sure=False) == "above"
    assert evidence(Heights(-0.0002, 0.0002, 0.0006, 0.0), sure=False) == "unknown"
    # Dark cloth that a camera measures 3 mm too far, with a fold that rises above the table for all that.
    assert evidence(Heights(-0.002, -0.002, 0.009, 0.0003), sure=False) == "above"
    # As far up as down: a table of which the slope is wrong.
    assert evidence(Heights(-0.005, 0.0, 0.006, 0.0003), sure=True) == "unknown"


def test_heights_of_patches_are_medians_and_the_tables_tell_how_sure() -> None:
    random = np.random.default_rng(1)
    cloth = random.uniform([0, 0, 0.004], [0.2, 0.2, 0.006], (4000, 3))
    table = random.normal(0, 0.003, (40_000, 3)) * [0, 0, 1] + random.uniform([-1, -1, 0], [1, 1, 0], (40_000, 3))
    found = heights_of(LEVEL, cloth, table, patch=0.1, flat=0.01)
    assert found.middle == pytest.approx(0.005, abs=2e-4)
    # A hundred points a patch: the median of them is off by 1.25 sigma / 10.
    assert found.deviation == pytest.approx(0.003 * 1.2533 / 10, rel=0.2)
    turned = heights_of(Plane(-LEVEL.normal, 0.0), cloth, table, patch=0.1, flat=0.01)
    assert turned.middle == pytest.approx(-found.middle, abs=2e-4)
    upside_down = Heights(-0.006, -0.005, -0.004, 0.0)
    same_side = oriented(
        LEVEL, upside_down, stated=Stated(), viewpoint=np.array([0, 0, -1.0]), told=False, near=0.008, name="cloud"
    )
    np.testing.assert_allclose(same_side.normal, [0, 0, -1])
