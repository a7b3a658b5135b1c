"""Silhouettes: areas against those of known shapes, places against the mesh that was seen, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clothkit.app.inputs import read_input
from clothkit.app.options import observation_options
from clothkit.app.settings import AppConfig
from clothkit.observation.arrays import read_numpy
from clothkit.observation.camera import CameraConfig
from clothkit.observation.observe import observe
from clothkit.observation.silhouettes import points_of
from clothkit.observation.states import MeshState, SilhouetteState
from clothkit.runtime.errors import InputError
from tests.observation.scenes import CLOTH, SCALE, SMALL, folded, image_of

THICKNESS = 0.002


def matrix(camera: CameraConfig) -> np.ndarray:
    """The camera's matrix, for which the first pixel's centre is at 0, 0."""
    column, row = camera.middle()
    return np.array([[camera.focal, 0, column - 0.5], [0, camera.focal, row - 0.5], [0, 0, 1]])


def height_of(layers: float) -> float:
    return (layers - 0.5) * THICKNESS


@settings(deadline=None, max_examples=8)
@given(
    tilt=st.floats(0, 0.6),
    azimuth=st.floats(0, 6.3),
    height=st.floats(0.6, 0.9),
    fold=st.sampled_from([(1.0, 1.0), (0.0, 2.0)]),
)
def test_the_number_of_layers_is_told_by_the_area(
    tilt: float, azimuth: float, height: float, fold: tuple[float, float]
) -> None:
    along, layers = fold
    camera = CameraConfig(tilt=tilt, azimuth=azimuth, height=height)
    image = image_of(folded(along=along), camera)
    state = SilhouetteState(image.cloth, intrinsics=matrix(camera))
    cloud = points_of(state, area=CLOTH**2, thickness=THICKNESS, table=camera.table(), name="s")
    # A pixel is 2.7 mm wide, and the fold's round edge is cloth, too.
    heights = camera.table().heights(cloud.points)
    np.testing.assert_allclose(heights, height_of(layers), atol=0.04 * layers * THICKNESS)
    # Seen from their own camera, the points are where the cloth is.
    on_table = (cloud.points @ camera.axes() + camera.position())[:, :2]
    assert np.abs(on_table).max(0) == pytest.approx(np.abs(folded(along=along)[..., :2] * SCALE).max((0, 1)), abs=0.008)


def test_a_picture_from_above_and_a_camera_show_the_columns_of_the_mesh(tmp_path: Path) -> None:
    mesh = folded(along=0.0, angle=0.3)
    expected = observe(MeshState(mesh, np.zeros(2, np.float32), SCALE), cloth_side=CLOTH).voxels[..., 0]
    camera = CameraConfig(tilt=0.3)
    above = CameraConfig(columns=600, rows=600, focal=1000.0, height=1.0)
    np.savez(tmp_path / "camera.npz", silhouette=image_of(mesh, camera).cloth, K=matrix(camera))
    np.savez(tmp_path / "above.npz", silhouette=image_of(mesh, above).cloth * np.uint8(255), pixel=0.001)
    plane = camera.table()
    options = observation_options(
        AppConfig(), side=CLOTH, thickness=THICKNESS, table=(*plane.normal.tolist(), plane.offset)
    )
    for name in ("camera", "above"):
        found = read_input(str(tmp_path / f"{name}.npz"), options)
        columns = found.observation.voxels[..., 0]
        assert (columns & expected).sum() / (columns | expected).sum() > 0.93
        assert "shows no heights; it is taken for" in " ".join(found.notices)


def test_a_camera_needs_its_table(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", silhouette=image_of(folded(), SMALL).cloth, K=matrix(SMALL))
    with pytest.raises(InputError, match=r"is a silhouette before a camera, expected the table's plane"):
        read_input(str(tmp_path / "a.npz"), observation_options(AppConfig(), side=CLOTH))
    beside = observation_options(AppConfig(), side=CLOTH, table=(1.0, 0.0, 0.0, 0.1))
    with pytest.raises(InputError, match=r"has pixels that do not show the table"):
        read_input(str(tmp_path / "a.npz"), beside)


@pytest.mark.parametrize(
    ("arrays", "sentence"),
    [
        ({}, r"has silhouette but neither pixel, .*, nor K"),
        ({"pixel": 0.0}, r"pixel is 0.0, expected the side of a pixel in metres"),
        ({"pixel": np.ones(2)}, r"pixel is \[1.0, 1.0\], expected"),
        ({"K": np.eye(4)}, r"K has shape \[4, 4\]"),
        ({"silhouette": np.ones((3, 70, 80)), "pixel": 0.001}, r"silhouette is float64 \[3, 70, 80\], expected"),
        ({"silhouette": np.full((70, 80), 7), "pixel": 0.001}, r"silhouette is int64 \[70, 80\], expected"),
        ({"silhouette": np.zeros((70, 80)), "pixel": 0.001}, r"silhouette has no pixel that is the cloth's"),
    ],
)
def test_what_is_no_silhouette(tmp_path: Path, arrays: dict, sentence: str) -> None:
    np.savez(tmp_path / "a.npz", **{"silhouette": np.ones((70, 80)), **arrays})
    with pytest.raises(InputError, match=sentence):
        read_numpy(tmp_path / "a.npz", cloth_side=CLOTH)


def test_a_depth_image_tells_more(tmp_path: Path) -> None:
    image = image_of(folded(), SMALL)
    np.savez(tmp_path / "a.npz", silhouette=image.cloth, depth=image.depth, K=matrix(SMALL), pixel=0.001)
    state = read_numpy(tmp_path / "a.npz", cloth_side=CLOTH)
    assert not isinstance(state, SilhouetteState)
    assert any("silhouette" in notice for notice in state.notices)


def test_a_flat_cloth_is_one_layer() -> None:
    state = SilhouetteState(np.ones((400, 400), bool), pixel=0.001)
    cloud = points_of(state, area=0.16, thickness=THICKNESS, table=None, name="s")
    np.testing.assert_allclose(cloud.points[:, 2], height_of(1))
    assert len(cloud.points) == 160_000
