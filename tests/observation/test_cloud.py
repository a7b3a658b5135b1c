"""What a camera sees becomes the voxels that it was rendered from, in any frame, and bad clouds get one sentence."""

import dataclasses
import resource

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from clothkit.cloth import voxels
from clothkit.cloth.silhouette import silhouette
from clothkit.cloth.topology import SQUARE
from clothkit.observation.camera import CameraConfig, back_project
from clothkit.observation.cloud import closed, observe_cloud, smoothed, voxels_of_points
from clothkit.observation.coverage import centre, covered, goal_iou, spacing
from clothkit.observation.noise import NoiseConfig, noisy
from clothkit.observation.plane import LEVEL, plane_of
from clothkit.observation.segment import segment, without_outliers
from clothkit.observation.settings import CloudConfig
from clothkit.observation.states import PointCloud
from clothkit.runtime.errors import InputError
from tests.observation.scenes import CLOTH, SCALE, folded, image_of, motion

CAMERA = CameraConfig()
CLOUD = back_project(image_of(folded(), CAMERA, at=(0.04, -0.02)))
TRUTH = np.asarray(voxels.observe(folded()))
ALONE = PointCloud(CLOUD.points[CLOUD.cloth])


def difference(found: np.ndarray, truth: np.ndarray) -> float:
    """The share of the truth's voxels that are wrong, either way."""
    return float((found != truth).sum() / truth.sum())


def test_a_clean_overhead_view_gives_the_voxels_of_the_mesh() -> None:
    seen = observe_cloud(CLOUD, cloth_side=CLOTH)
    assert difference(seen.voxels, TRUTH) < 0.05
    # The camera's frame is level: the table's x is the image's, and its origin below the camera.
    np.testing.assert_allclose(seen.pose.centre, [0.04, -0.02], atol=0.002)
    assert seen.pose.scale == pytest.approx(SCALE)
    corner = seen.pose.normalised_to_camera(np.array([0.0, 0.0, 0.0]))
    np.testing.assert_allclose(corner, [0.04, 0.02, 0.8], atol=0.003)
    assert (np.diff(seen.voxels.astype(int), axis=-1) <= 0).all()


@pytest.mark.parametrize("tilt", [0.0, 0.35])
def test_a_noisy_view_gives_nearly_the_same(tilt: float) -> None:
    camera = CameraConfig(tilt=tilt)
    image = noisy(image_of(folded(), camera, at=(0.03, 0.05)), NoiseConfig(), seed=3)
    seen = observe_cloud(back_project(image), cloth_side=CLOTH)
    assert difference(seen.voxels, TRUTH) < 0.2
    assert np.abs(seen.voxels[..., 0].astype(int) - TRUTH[..., 0]).sum() < 0.08 * TRUTH[..., 0].sum()
    place = seen.pose.normalised_to_camera(np.zeros(3)) @ camera.axes() + camera.position()
    np.testing.assert_allclose(place, [0.03, 0.05, 0.0], atol=0.004)


@settings(max_examples=4)
@given(st.integers(0, 10_000))
def test_the_frame_of_the_cloud_does_not_matter(seed: int) -> None:
    rotation, shift = motion(seed)
    moved = PointCloud(CLOUD.points @ rotation.T + shift, cloth=CLOUD.cloth, viewpoint=shift)
    seen, plain = observe_cloud(moved, cloth_side=CLOTH), observe_cloud(CLOUD, cloth_side=CLOTH)
    # The same points, turned about z by whatever the table's frame has become. Ties of neighbours may fall differently.
    back = seen.pose.normalised_to_camera(seen.points.astype(float))
    expected = plain.pose.normalised_to_camera(plain.points.astype(float)) @ rotation.T + shift
    np.testing.assert_allclose(back, expected, atol=2e-4)
    there = seen.pose.normalised_to_camera(np.zeros(3))
    np.testing.assert_allclose(there, plain.pose.normalised_to_camera(np.zeros(3)) @ rotation.T + shift, atol=0.002)


def test_a_segmented_cloud_needs_the_table_and_gives_the_same() -> None:
    with_table = observe_cloud(ALONE, cloth_side=CLOTH, table=CAMERA.table())
    assert difference(with_table.voxels, TRUTH) < 0.05
    carried = observe_cloud(dataclasses.replace(ALONE, table=CAMERA.table()), cloth_side=CLOTH)
    np.testing.assert_array_equal(carried.voxels, with_table.voxels)


def test_colours_tell_the_table() -> None:
    colours = np.where(CLOUD.cloth[:, None], [40, 90, 200], [200, 180, 150]).astype(np.uint8)
    coloured = PointCloud(CLOUD.points, colours=colours, viewpoint=np.zeros(3))
    wooden = CloudConfig(table_colour=((180, 160, 130), (220, 200, 170)))
    seen = observe_cloud(coloured, cloth_side=CLOTH, settings=wooden)
    np.testing.assert_array_equal(seen.voxels, observe_cloud(CLOUD, cloth_side=CLOTH).voxels)


def test_a_real_cloths_surface_is_lowered_by_half_its_thickness() -> None:
    lifted = PointCloud(ALONE.points - [0, 0, 0.004])
    seen = observe_cloud(lifted, cloth_side=CLOTH, table=CAMERA.table(), settings=CloudConfig(surface=0.004))
    assert difference(seen.voxels, TRUTH) < 0.05
    higher = observe_cloud(lifted, cloth_side=CLOTH, table=CAMERA.table())
    assert higher.voxels.sum() > 1.5 * seen.voxels.sum()


def test_invalid_points_strays_and_distant_things_change_little() -> None:
    random = np.random.default_rng(0)
    strays = random.uniform([-0.3, -0.25, 0.72], [0.3, 0.25, 0.78], (60, 3))
    wall = random.uniform([1, -1, 0.2], [1.01, 1, 3], (200, 3))
    bad = np.concatenate([np.full((500, 3), np.nan), np.zeros((500, 3))])
    points = np.concatenate([CLOUD.points, bad, strays, wall])
    mask = np.concatenate([CLOUD.cloth, np.ones(1000, bool), np.ones(60, bool), np.zeros(200, bool)])
    seen = observe_cloud(PointCloud(points, cloth=mask), cloth_side=CLOTH)
    assert difference(seen.voxels, TRUTH) < 0.07


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([3e3, 5e4, 1e38]))
def test_strays_however_far_change_nothing(seed: int, away: float) -> None:
    """A raster over fifteen strays 3 km away would take 26 GiB."""
    random = np.random.default_rng(seed)
    place = random.normal(size=2)
    place *= away / np.linalg.norm(place)
    strays = np.column_stack([place + random.normal(0, 1e-3, (15, 2)), np.full(15, 0.8)])
    points = np.concatenate([CLOUD.points, strays])
    mask = np.append(CLOUD.cloth, np.ones(15, bool))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    seen = observe_cloud(PointCloud(points, cloth=mask), cloth_side=CLOTH)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500_000
    np.testing.assert_array_equal(seen.voxels, observe_cloud(CLOUD, cloth_side=CLOTH).voxels)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 6))
def test_pieces_are_those_of_a_raster(seed: int, count: int) -> None:
    """What is kept of scattered blobs is the piece of most cells of their picture, told here by labelling an image."""
    random = np.random.default_rng(seed)
    sizes = np.r_[0.1, np.full(count, 0.012)]
    middles = np.concatenate([np.zeros((1, 2)), random.uniform(-0.25, 0.25, (count, 2))])
    blobs = [
        random.uniform(-size, size, (60_000 if size > 0.05 else 60, 2)) + xy
        for size, xy in zip(sizes, middles, strict=True)
    ]
    xy = np.concatenate(blobs)
    cloth = np.column_stack([xy, np.zeros(len(xy))])
    plain = CloudConfig(neighbours=0, most=100_000)
    kept = segment(PointCloud(cloth, table=LEVEL), cloth_side=CLOTH, settings=plain).cloth
    cell = CLOTH / (0.7 * 32)
    index = np.floor((xy - xy.min(0)) / cell).astype(int)
    image = np.zeros(index.max(0) + 1, bool)
    image[tuple(index.T)] = True
    labels, _ = ndimage.label(image, structure=np.ones((3, 3)))
    largest = np.bincount(labels[image]).argmax()
    np.testing.assert_array_equal(kept, cloth[labels[tuple(index.T)] == largest])


def test_half_of_the_points_give_nearly_the_same() -> None:
    thinned = observe_cloud(CLOUD, cloth_side=CLOTH, settings=CloudConfig(most=8000))
    assert 7000 < len(thinned.points) <= 8000
    assert difference(thinned.voxels, TRUTH) < 0.05


def test_outliers_are_those_far_from_their_neighbours() -> None:
    grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0), [0.0]), -1).reshape(-1, 3)
    far = np.array([[10.0, 10.0, 9.0], [40.0, 0.0, 0.0]])
    kept = without_outliers(np.concatenate([grid, far]), CloudConfig())
    np.testing.assert_array_equal(kept, grid)
    untouched = without_outliers(np.concatenate([grid, far]), CloudConfig(neighbours=0))
    assert len(untouched) == len(grid) + 2


def test_smoothing_takes_noise_and_keeps_steps() -> None:
    random = np.random.default_rng(0)
    axis = np.arange(60) * 0.003
    x, y = (part.ravel() for part in np.meshgrid(axis, axis, indexing="ij"))
    step = np.where(x < 0.09, 0.0, 0.01)
    points = np.column_stack([x, y, step + random.normal(0, 0.001, len(x))])
    smooth = smoothed(points, radius=0.009)
    off = np.abs(smooth[:, 2] - step)
    assert off.mean() < 0.4 * np.abs(points[:, 2] - step).mean()
    assert (off > 0.004).mean() < 0.02
    np.testing.assert_array_equal(smoothed(points, radius=0.0), points)
    assert spacing(points[:, :2]) == pytest.approx(0.003, rel=0.1)


def test_voxels_of_points_are_those_of_the_library_and_thin_columns_stay_empty() -> None:
    random = np.random.default_rng(1)
    points = random.uniform([-1.1, -1.1, 0], [1.1, 1.1, 0.13], (3000, 3))
    expected = np.asarray(voxels.occlude(voxels.voxelise(points.astype(np.float32))))
    np.testing.assert_array_equal(voxels_of_points(points), expected)
    dense = np.repeat([[0.03, 0.03, 0.02], [0.1, 0.03, 0.02]], 10, axis=0)
    lone = np.array([[0.5, 0.5, 0.02]])
    kept = voxels_of_points(np.concatenate([dense, lone]), covered=0.2)
    assert kept[16:18, 16, 0].all()
    assert kept[..., 0].sum() == 2


def test_small_gaps_close_where_no_table_is_seen() -> None:
    cloth = np.zeros((32, 32, 16), bool)
    cloth[8:20, 8:20, :3] = True
    torn = cloth.copy()
    torn[10, 10], torn[14:16, 14], torn[17, 8:12] = False, False, False
    filled = closed(torn, np.ones((32, 32), bool), most=4)
    assert filled[10, 10, :3].all()
    assert not filled[10, 10, 3:].any()
    assert filled[14:16, 14, :3].all()
    # Open to the outside, and so no gap within.
    assert not filled[17, 8:12].any()
    unseen = np.ones((32, 32), bool)
    unseen[10, 10] = False
    assert not closed(torn, unseen, most=4)[10, 10].any()
    assert not closed(torn, np.ones((32, 32), bool), most=1)[14, 14].any()


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.5, 3))
def test_the_centre_is_that_of_the_area_and_not_of_the_points(x: float, y: float, power: float) -> None:
    random = np.random.default_rng(0)
    # Many more points at one side than at the other.
    xy = np.column_stack([random.random(6000) ** power, random.random(6000)])
    grid = np.stack(np.meshgrid(np.linspace(0, 1, 40), np.linspace(0, 1, 40)), -1).reshape(-1, 2)
    found = centre(np.concatenate([xy, grid]) + np.array([x, y]), extent=1.1)
    np.testing.assert_allclose(found, [x + 0.5, y + 0.5], atol=0.02)


def test_points_of_a_mesh_cover_its_silhouette() -> None:
    mesh = folded(angle=0.4)
    points = observe_cloud(back_project(image_of(mesh, CAMERA)), cloth_side=CLOTH).points
    assert goal_iou(mesh, points) > 0.95
    assert goal_iou(SQUARE.flat(), points) == pytest.approx(
        silhouette(mesh).sum() / silhouette(SQUARE.flat()).sum(), abs=0.08
    )
    assert covered(points[:, :2], resolution=64).shape == (64, 64)


TABLE = CAMERA.table()


def two() -> PointCloud:
    first, second = (CLOUD.points[CLOUD.cloth] * [0.5, 0.5, 1] + [x, 0, 0] for x in (-0.13, 0.13))
    return PointCloud(np.concatenate([first, second]), table=TABLE)


@pytest.mark.parametrize(
    ("cloud", "sentence"),
    [
        (PointCloud(np.zeros((0, 3))), "is empty, expected points"),
        (PointCloud(np.full((50, 3), np.nan)), "is an empty view, none of its 50 points is finite"),
        (PointCloud(np.full((50, 3), 3.4e38)), "is an empty view, none of its 50 points"),
        (PointCloud(np.zeros((50, 3))), "other than \\(0, 0, 0\\)"),
        (PointCloud(np.ones((50, 3))), "50 points are the cloth's, expected at least 100"),
        (dataclasses.replace(CLOUD, cloth=np.zeros(len(CLOUD.points), bool)), "0 points are the cloth's"),
        (dataclasses.replace(CLOUD, cloth=np.ones(7, bool)), "cloth has 7 rows"),
        (dataclasses.replace(CLOUD, points=CLOUD.points * 1000), "spans 3.* in millimetres, expected metres"),
        (dataclasses.replace(CLOUD, points=CLOUD.points * 100), "in centimetres, expected metres"),
        (dataclasses.replace(CLOUD, points=CLOUD.points / 1000), "check the units"),
        (PointCloud(CLOUD.points, table=TABLE), "if the table is among the points, give a mask"),
        (ALONE, "table not found, nothing tells cloth and table apart"),
        (dataclasses.replace(ALONE, table=plane_of((0.0, 0.0, -1.0, -1.2))), "table not found where .* 0.4.* m above"),
        (dataclasses.replace(ALONE, table=plane_of((0.0, 0.0, -1.0, -0.5))), "table not found where .* below"),
        (two(), "two objects where one cloth was expected"),
    ],
)
def test_bad_clouds_get_one_sentence(cloud: PointCloud, sentence: str) -> None:
    with pytest.raises(InputError, match=f"^shelf: .*{sentence}") as raised:
        observe_cloud(cloud, cloth_side=CLOTH, name="shelf")
    assert "\n" not in str(raised.value)


def test_tables_that_are_none_get_one_sentence() -> None:
    random = np.random.default_rng(0)
    few = np.concatenate([np.flatnonzero(CLOUD.cloth), np.flatnonzero(~CLOUD.cloth)[:20]])
    sparse = PointCloud(CLOUD.points[few], cloth=CLOUD.cloth[few])
    with pytest.raises(InputError, match="table not found, there are 20 points outside the cloth"):
        observe_cloud(sparse, cloth_side=CLOTH)
    fog = random.uniform([-0.5, -0.5, 0.3], [0.5, 0.5, 1.3], (5000, 3))
    mask = np.concatenate([np.ones(len(ALONE.points), bool), np.zeros(5000, bool)])
    foggy = PointCloud(np.concatenate([ALONE.points, fog]), cloth=mask)
    with pytest.raises(InputError, match=r"table not found, of the points outside the cloth [0-9]+% lie on one plane"):
        observe_cloud(foggy, cloth_side=CLOTH)
    in_it = dataclasses.replace(CLOUD, viewpoint=np.array([0.1, 0.1, 0.8]))
    with pytest.raises(InputError, match="the viewpoint lies in the table"):
        observe_cloud(in_it, cloth_side=CLOTH)
    with pytest.raises(InputError, match=r"a x \+ b y"):
        plane_of((0.0, 0.0, 0.0, 1.0))


def test_a_table_that_is_told_is_where_it_is_seen() -> None:
    wrong = plane_of((0.0, 0.0, -1.0, -0.81))
    assert CAMERA.table().offset == pytest.approx(-0.8)
    with pytest.raises(InputError, match="the points around the cloth lie 10 mm above the table's plane, expected at"):
        observe_cloud(CLOUD, cloth_side=CLOTH, table=wrong)
    # Where no table is seen it can't be told, and things beside the cloth are no table.
    observe_cloud(ALONE, cloth_side=CLOTH, table=wrong)
    count = len(ALONE.points)
    heap = np.random.default_rng(0).uniform([0.3, -0.1, 0.7], [0.38, 0.1, 0.8], (3000, 3))
    beside = PointCloud(np.concatenate([ALONE.points, heap]), cloth=np.arange(count + 3000) < count)
    observe_cloud(beside, cloth_side=CLOTH, table=TABLE)


def test_settings_that_do_not_fit_the_cloud_get_one_sentence() -> None:
    with pytest.raises(InputError, match="has no colours, but table_colour"):
        observe_cloud(ALONE, cloth_side=CLOTH, settings=CloudConfig(table_colour=((0, 0, 0), (9, 9, 9))))
    with pytest.raises(InputError, match="none of its points lies in the box"):
        observe_cloud(CLOUD, cloth_side=CLOTH, settings=CloudConfig(box=((5.0, 5.0, 5.0), (6.0, 6.0, 6.0))))
    with pytest.raises(InputError, match="cloth side 0: expected metres"):
        observe_cloud(CLOUD, cloth_side=0.0)
    # Half of the side: what is seen is more than such a cloth can cover.
    with pytest.raises(InputError, match=r"a cloth of side 0\.25 m can; check its side"):
        observe_cloud(CLOUD, cloth_side=0.25)


def test_a_box_crops_other_things() -> None:
    other = CLOUD.points[CLOUD.cloth] + [0.9, 0, 0]
    points = np.concatenate([CLOUD.points, other])
    mask = np.concatenate([CLOUD.cloth, np.ones(len(other), bool)])
    box = CloudConfig(box=((-0.4, -0.4, 0.5), (0.4, 0.4, 1.0)))
    seen = observe_cloud(PointCloud(points, cloth=mask), cloth_side=CLOTH, settings=box)
    assert difference(seen.voxels, TRUTH) < 0.05


def test_points_on_the_table_of_their_own_frame() -> None:
    level = observe_cloud(PointCloud(folded_points(), table=LEVEL), cloth_side=CLOTH)
    np.testing.assert_array_equal(level.pose.rotation, np.eye(3))
    assert difference(level.voxels, TRUTH) < 0.05


def folded_points() -> np.ndarray:
    return (CLOUD.points[CLOUD.cloth] - [0.04, 0.02, 0.8]) * [1, -1, -1]
